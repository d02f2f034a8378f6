use super::*;
use crate::geometry::PixelBox;

pub(super) fn record(outcome: Outcome) -> FrameRecord {
    FrameRecord {
        frame: "00042".to_owned(),
        left: "l.png".to_owned(),
        right: "r.png".to_owned(),
        time_s: None,
        outcome,
    }
}

pub(super) fn vehicle(detected_in: DetectedIn) -> Vehicle {
    let boxes = [
        PixelBox::new(1.0, 2.0, 3.5, 4.0),
        PixelBox::new(0.0, 2.0, 2.5, 4.0),
    ];
    Vehicle {
        detected_in,
        disparity_px: (detected_in != DetectedIn::Both).then_some(1.5),
        distance_std_m: Some(0.5),
        distance_low_m: Some(11.25),
        distance_high_m: Some(13.5),
        size_m: Some(12.5),
        stereo_m: Some(12.0),
        ..Vehicle::bare(boxes[0], boxes[1], "car, \"red\"", 12.25)
    }
}

fn alone() -> Unmatched {
    Unmatched {
        detected_in: DetectedIn::Right,
        box_pixel: PixelBox::new(5.0, 6.0, 7.0, 8.0),
        score: 0.25,
        class: "truck".to_owned(),
    }
}

pub(super) fn measured(vehicles: Vec<Vehicle>, without_distance: Vec<Unmatched>) -> Outcome {
    Outcome::Measured {
        vehicles,
        without_distance,
    }
}

fn failed() -> Outcome {
    Outcome::Failed {
        error: "image l.png: the file is empty; write it again".to_owned(),
    }
}

#[test]
fn a_line_of_json_says_what_was_found_or_why_nothing_could_be() {
    for (outcome, expected) in [
        (measured(vec![], vec![]), r#""vehicles":[]}"#),
        (
            failed(),
            r#""error":"image l.png: the file is empty; write it again"}"#,
        ),
    ] {
        let line = record(outcome).to_line().unwrap();
        let beginning = r#"{"frame":"00042","left":"l.png","right":"r.png","#;
        assert_eq!(line, format!("{beginning}{expected}\n"));
    }
    let line = record(measured(vec![vehicle(DetectedIn::Both)], vec![alone()]))
        .to_line()
        .unwrap();
    for part in [
        r#""left":{"x_min":1.0,"y_min":2.0,"x_max":3.5,"y_max":4.0}"#,
        r#""distance_m":12.25,"distance_std_m":0.5,"distance_low_m":11.25,"distance_high_m":13.5"#,
        r#""size_m":12.5,"stereo_m":12.0,"network_m":null,"doubt":null,"detected_in":"both""#,
        r#""disparity_px":null}"#,
        r#""without_distance":[{"detected_in":"right","box":{"x_min":5.0"#,
    ] {
        assert!(line.contains(part), "{part} in {line}");
    }
    assert_eq!(line.matches('\n').count(), 1);
    let searched = record(measured(vec![vehicle(DetectedIn::Left)], vec![]));
    let line = searched.to_line().unwrap();
    assert!(
        line.contains(r#""detected_in":"left","disparity_px":1.5}"#),
        "{line}"
    );
}

#[test]
fn lines_of_programs_that_did_not_tell_the_disparity_are_read() {
    let record = record(measured(vec![vehicle(DetectedIn::Both)], vec![]));
    let line = record.to_line().unwrap();
    let without = line.replace(r#","disparity_px":null"#, "");
    assert!(without.len() < line.len());
    assert_eq!(
        serde_json::from_str::<FrameRecord>(&without).unwrap(),
        record
    );
}

#[test]
fn records_come_back_from_their_lines() {
    for outcome in [
        measured(vec![vehicle(DetectedIn::Left)], vec![alone()]),
        measured(vec![], vec![]),
        failed(),
    ] {
        let record = FrameRecord {
            time_s: Some(0.5),
            ..record(outcome)
        };
        let line = record.to_line().unwrap();
        assert_eq!(serde_json::from_str::<FrameRecord>(&line).unwrap(), record);
    }
}

#[test]
fn a_table_has_one_row_a_vehicle_under_its_header() {
    let columns = CsvFile::header().trim().split(',').count();
    let record = record(measured(vec![vehicle(DetectedIn::Left)], vec![alone()]));
    let rows = CsvFile::rows(&record).unwrap();
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .from_reader(rows.as_bytes());
    let rows: Vec<Vec<String>> = reader
        .records()
        .map(|row| row.unwrap().iter().map(str::to_owned).collect())
        .collect();
    assert!(rows.iter().all(|row| row.len() == columns), "{rows:?}");
    assert_eq!(
        rows[0],
        [
            "00042",
            "",
            "1",
            "car, \"red\"",
            "0.5",
            "12.25",
            "0.5",
            "11.25",
            "13.5",
            "12.5",
            "12",
            "",
            "",
            "left",
            "1",
            "2",
            "3.5",
            "4",
            "0",
            "2",
            "2.5",
            "4",
            "1.5"
        ]
    );
    assert_eq!(
        rows[1],
        [
            "00042", "", "2", "truck", "0.25", "", "", "", "", "", "", "", "", "right", "", "", "",
            "", "5", "6", "7", "8", ""
        ]
    );
    let without = FrameRecord {
        outcome: failed(),
        ..record
    };
    assert_eq!(CsvFile::rows(&without).unwrap(), "");
}

#[test]
fn the_summary_counts_every_kind_of_frame() {
    let mut summary = PredictSummary::default();
    for outcome in [
        measured(
            vec![vehicle(DetectedIn::Both), vehicle(DetectedIn::Left)],
            vec![],
        ),
        measured(vec![], vec![alone()]),
        measured(vec![], vec![]),
        failed(),
    ] {
        summary.count(&record(outcome));
    }
    let PredictSummary {
        frames,
        failed,
        empty,
        vehicles,
        single_sided,
        without_distance,
        reasons,
        ..
    } = summary;
    assert_eq!([frames, failed, empty], [4, 1, 1]);
    assert_eq!([vehicles, single_sided, without_distance], [2, 1, 1]);
    assert_eq!(reasons.len(), 1);
    assert!(reasons[0].1.contains("empty"));
}
