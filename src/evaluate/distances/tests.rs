use super::*;
use crate::dataset::View;

/// A vehicle whose network estimate is off by 10 % and whose size estimate by 30 %.
fn vehicle(frame: u64, distance_m: f64, found: bool) -> VehicleRow {
    VehicleRow {
        frame,
        id: 0,
        class: "car".to_owned(),
        scene: Some(frame as u32 / 2),
        sun: Some(
            if frame.is_multiple_of(2) {
                "noon"
            } else {
                "sunrise"
            }
            .to_owned(),
        ),
        view: (frame > 2).then_some(View::Side),
        box_px: 400.0 / distance_m,
        distance_m,
        network_m: Some(distance_m * 1.1),
        size_m: Some(distance_m * 0.7),
        triangulation_m: None,
        matching_m: None,
        found,
        score: found.then_some(0.9),
        overlap: None,
        found_x_min: None,
        found_y_min: None,
        found_x_max: None,
        found_y_max: None,
        pipeline_network_m: found.then_some(distance_m * 1.2),
        pipeline_size_m: None,
        pipeline_triangulation_m: None,
        pipeline_matching_m: None,
        ..VehicleRow::default()
    }
}

fn vehicles() -> Vec<VehicleRow> {
    (0..20)
        .map(|i| vehicle(i, 11.0 + i as f64, !i.is_multiple_of(5)))
        .collect()
}

fn drawing(vehicles: &[VehicleRow]) -> Drawing {
    let frames: Vec<_> = vehicles.iter().map(|v| (v.frame, v.scene)).collect();
    Drawing::new(&frames, 200)
}

fn false_vehicle(estimated_m: f64) -> FalseVehicle {
    FalseVehicle {
        frame: 3,
        class: "car".to_owned(),
        scene: None,
        sun: Some("noon".to_owned()),
        score: 0.5,
        estimated_m,
        x_min: 0.0,
        y_min: 0.0,
        x_max: 20.0,
        y_max: 10.0,
    }
}

#[test]
fn every_grouping_counts_every_vehicle_once_and_every_false_one_that_it_can() {
    let vehicles = vehicles();
    let made_up = [false_vehicle(12.0), false_vehicle(95.0)];
    let rows = rows(&vehicles, &made_up, &drawing(&vehicles), Method::Network);
    for grouping in [
        Grouping::All,
        Grouping::Distance,
        Grouping::Sun,
        Grouping::View,
        Grouping::Box,
    ] {
        let of = |boxes: Boxes| {
            rows.iter().filter(move |row| {
                (row.grouping, row.boxes, row.method) == (grouping, boxes, Method::Network)
            })
        };
        for boxes in Boxes::ALL {
            assert_eq!(of(boxes).map(|row| row.vehicles).sum::<usize>(), 20);
        }
        let missed: usize = of(Boxes::Pipeline).map(|row| row.unanswered).sum();
        assert_eq!(missed, 4, "{grouping:?}");
        let made_up: usize = of(Boxes::Pipeline)
            .filter_map(|row| row.false_vehicles)
            .sum();
        assert_eq!(
            made_up,
            if grouping == Grouping::View { 0 } else { 2 },
            "{grouping:?}"
        );
    }
    assert!(
        rows.iter().all(|row| row.method != Method::Matching),
        "it has no answers"
    );
    assert!(
        rows.iter().all(|row| row.grouping != Grouping::Class),
        "there is one class"
    );
}

#[test]
fn one_vehicle_has_a_bin_of_metres_and_none_at_all_have_no_bins() {
    let vehicles = [vehicle(3, 12.4181, true)];
    let made_up = [
        false_vehicle(12.0),
        false_vehicle(12.6),
        false_vehicle(95.0),
    ];
    let bins = |rows: Vec<DistanceRow>| -> Vec<String> {
        let rows = rows.into_iter().filter(|row| {
            (row.grouping, row.boxes, row.method)
                == (Grouping::Distance, Boxes::True, Method::Network)
        });
        rows.map(|row| row.group).collect()
    };
    let drawing = drawing(&vehicles);
    assert_eq!(
        bins(rows(&vehicles, &made_up, &drawing, Method::Network)),
        ["12-14 m", "94-96 m"]
    );
    assert!(bins(rows(&[], &made_up, &drawing, Method::Network)).is_empty());
}

#[test]
fn bounds_hold_the_figure_and_a_constant_relative_error_has_no_spread() {
    let vehicles = vehicles();
    let rows = rows(&vehicles, &[], &drawing(&vehicles), Method::Network);
    let all = &rows[0];
    assert!((all.mre_percent.unwrap() - 10.0).abs() < 1e-9);
    assert!((all.mre_high_percent.unwrap() - all.mre_low_percent.unwrap()).abs() < 1e-9);
    let (low, high) = (all.mae_low_m.unwrap(), all.mae_high_m.unwrap());
    assert!(low < all.mae_m.unwrap() && all.mae_m.unwrap() < high);
}

#[test]
fn a_network_that_is_better_everywhere_is_better_beyond_chance() {
    let vehicles = vehicles();
    let rows = differences(&vehicles, &drawing(&vehicles), Method::Network);
    assert_eq!(
        rows.len(),
        1,
        "only the size has answers, and only for true boxes"
    );
    assert_eq!((rows[0].method, rows[0].vehicles), (Method::Size, 20));
    assert!(rows[0].difference_m < 0.0 && rows[0].high_m.unwrap() < 0.0);
}

#[test]
fn scenes_are_drawn_whole_where_there_are_enough_and_known_and_frames_otherwise() {
    let by_scene = drawing(&vehicles());
    assert_eq!((by_scene.unit, by_scene.resamples.groups()), ("scene", 10));
    assert_eq!(by_scene.group(4), by_scene.group(5));
    let few: Vec<_> = (0..20).map(|i| (i, Some(i as u32 / 8))).collect();
    let unknown: Vec<_> = (0..20).map(|i| (i, (i > 0).then_some(i as u32))).collect();
    for frames in [few, unknown] {
        let by_frame = Drawing::new(&frames, 10);
        assert_eq!((by_frame.unit, by_frame.resamples.groups()), ("frame", 20));
    }
}
