use super::*;
use crate::dataset::fixture::Fixture;

/// Frames of the test's kind, and one vehicle for each with estimates that are off by a factor.
struct Capture {
    frames: Vec<Frame>,
    vehicles: Vec<VehicleRow>,
}

impl Capture {
    fn new() -> Self {
        Self {
            frames: Vec::new(),
            vehicles: Vec::new(),
        }
    }

    fn add(&mut self, distance_m: f64, sun: &str, view: View, estimate_m: f64, found: bool) {
        let stamp = self.frames.len() as u64 + 1;
        let mut frame = Fixture::lawful(1).open().frames.remove(0);
        frame.row.stamp = stamp;
        frame.row.distance_m = Some(distance_m);
        frame.row.sun = Some(sun.to_owned());
        frame.row.view = Some(view);
        self.frames.push(frame);
        self.vehicles.push(VehicleRow {
            frame: stamp,
            id: 0,
            class: "car".to_owned(),
            scene: None,
            sun: Some(sun.to_owned()),
            view: Some(view),
            box_px: 30.0,
            distance_m,
            network_m: Some(estimate_m),
            size_m: None,
            triangulation_m: None,
            matching_m: None,
            found,
            score: None,
            overlap: None,
            found_x_min: None,
            found_y_min: None,
            found_x_max: None,
            found_y_max: None,
            pipeline_network_m: found.then_some(estimate_m),
            pipeline_size_m: None,
            pipeline_triangulation_m: None,
            pipeline_matching_m: None,
            ..VehicleRow::default()
        });
    }

    fn protocol(&self) -> Protocol {
        let frames: Vec<&Frame> = self.frames.iter().collect();
        let made_up = FalseVehicle {
            frame: 1,
            class: "car".to_owned(),
            scene: None,
            sun: None,
            score: 0.5,
            estimated_m: 70.0,
            x_min: 0.0,
            y_min: 0.0,
            x_max: 9.0,
            y_max: 9.0,
        };
        protocol(&frames, &self.vehicles, &[made_up], Method::Network)
    }
}

fn row(protocol: &Protocol, boxes: Boxes, distance_m: f64) -> &ProtocolRow {
    let mut rows = protocol.rows.iter();
    rows.find(|row| (row.boxes, row.distance_m) == (boxes, Some(distance_m)))
        .unwrap()
}

#[test]
fn all_108_frames_leave_nothing_missing_and_the_paper_stands_beside_ours() {
    let mut capture = Capture::new();
    for (distance_m, _, _) in PAPER {
        for sun in SUNS {
            for (view, _) in VIEWS {
                capture.add(distance_m, sun.name(), view, distance_m * 1.1, true);
            }
        }
    }
    let protocol = capture.protocol();
    assert_eq!((protocol.cells, protocol.other_frames), (108, 0));
    assert_eq!(protocol.missing, []);
    for boxes in Boxes::ALL {
        let far = row(&protocol, boxes, 200.0);
        assert_eq!((far.frames, far.missed), (12, 0));
        assert!((far.noon_m.unwrap() - 220.0).abs() < 1e-9);
        assert!((far.rmse_of_means_m.unwrap() - 20.0).abs() < 1e-9);
        assert!((far.mre_percent.unwrap() - 10.0).abs() < 1e-9);
        assert_eq!(
            (far.paper_rmse_m, far.paper_mre_percent),
            (Some(11.29), Some(5.60))
        );
    }
    let mean = &protocol.rows[PAPER.len()];
    assert_eq!((mean.distance_m, mean.frames), (None, 108));
    assert!((mean.mre_percent.unwrap() - 10.0).abs() < 1e-9);
}

#[test]
fn errors_of_views_cancel_in_the_mean_of_a_sun_and_not_over_single_frames() {
    let mut capture = Capture::new();
    capture.add(55.0, "noon", View::Front, 50.0, true);
    capture.add(55.0, "noon", View::Rear, 60.0, true);
    let protocol = capture.protocol();
    let row = row(&protocol, Boxes::True, 55.0);
    assert_eq!((row.noon_m, row.sunrise_m), (Some(55.0), None));
    assert_eq!((row.rmse_of_means_m, row.rmse_m), (Some(0.0), Some(5.0)));
    assert_eq!((protocol.cells, protocol.missing.len()), (2, 106));
}

#[test]
fn a_missed_vehicle_is_counted_and_never_averaged() {
    let mut capture = Capture::new();
    capture.add(15.0, "morning", View::Side, 16.0, true);
    capture.add(15.0, "morning", View::Front, 30.0, false);
    let protocol = capture.protocol();
    let row = row(&protocol, Boxes::Pipeline, 15.0);
    assert_eq!((row.frames, row.missed, row.morning_m), (2, 1, Some(16.0)));
    assert_eq!(row.false_vehicles, Some(1));
}

#[test]
fn frames_at_other_distances_have_rows_of_their_own_and_those_that_say_nothing_have_none() {
    let mut capture = Capture::new();
    capture.add(22.0, "noon", View::Side, 22.0, true);
    capture.add(35.0, "sunset", View::Side, 35.0, true);
    capture.add(35.0, "noon", View::Other, 35.0, true);
    let protocol = capture.protocol();
    assert_eq!((protocol.cells, protocol.other_frames), (0, 1));
    assert_eq!(row(&protocol, Boxes::True, 22.0).paper_rmse_m, None);
    assert_eq!(row(&protocol, Boxes::True, 35.0).frames, 0);
    // The frame whose vehicle is not labelled in both images is missing, too.
    capture.vehicles.clear();
    assert_eq!(capture.protocol().other_frames, 0);
}
