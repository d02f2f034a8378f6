use std::fs;

use super::*;
use crate::dataset::BoxKind;
use crate::dataset::fixture::{Fixture, picture};
use crate::imaging::save_png;
use crate::progress::Silent;

/// Opens a dataset of which one frame was spoiled: frame 2 must be reported with each of the
/// words, and the others must be usable.
fn assert_frame_2_is_reported(fixture: &Fixture, words: &[&str]) {
    let dataset = fixture.open();
    assert_eq!(dataset.problems.len(), 1, "{:?}", dataset.problems);
    let text = dataset.problems[0].to_string();
    assert!(text.starts_with("frame 00002: "), "{text}");
    for word in words {
        assert!(text.contains(word), "{text} should contain {word}");
    }
    let stamps: Vec<_> = dataset.frames.iter().map(|frame| frame.row.stamp).collect();
    assert_eq!(stamps, [1, 3]);
}

#[test]
fn a_sound_dataset_is_read_whole() {
    let fixture = Fixture::new(10);
    let dataset = fixture.open();
    assert!(dataset.problems.is_empty(), "{:?}", dataset.problems);
    assert_eq!(dataset.frames.len(), 10);
    let count = |split| dataset.split(split).len();
    assert_eq!(
        [count(Split::Train), count(Split::Val), count(Split::Test)],
        [6, 2, 2]
    );
    assert_eq!(dataset.classes(), ["car"]);
    let frame = dataset.frame(7).unwrap();
    let vehicles = frame.vehicles(BoxKind::Sphere);
    assert_eq!(vehicles.len(), 1);
    assert_eq!((vehicles[0].id, vehicles[0].distance_m), (3, 17.0));
    assert_eq!(
        vehicles[0].left.box_pixel.x_min - vehicles[0].right.box_pixel.x_min,
        4.0
    );
    assert_eq!(
        frame.load(dataset.rig()).unwrap(),
        [picture(7, "left"), picture(7, "right")]
    );
    assert!(dataset.frame(11).is_none());
}

#[test]
fn missing_files_are_reported_by_frame() {
    let fixture = Fixture::new(3);
    fixture.remove("frames/left_00002.png");
    fixture.remove("frames/right_00002.txt");
    assert_frame_2_is_reported(
        &fixture,
        &["left image is missing", "right label file is missing"],
    );
}

#[test]
fn every_bad_label_line_is_reported_with_its_file_and_line() {
    for (line, words) in [
        ("3 0 NaN 10 50 40 35 25 12 sphere", "a coordinate is NaN"),
        ("3 0 20 10 50 inf 35 25 12 sphere", "a coordinate is inf"),
        ("3 0 20 10 50 40 35 25 NaN sphere", "the distance is NaN m"),
        ("3 0 50 10 20 40 35 25 12 sphere", "empty or inverted"),
        ("3 0 20 10 20 40 35 25 12 sphere", "empty or inverted"),
        (
            "3 0 96 10 120 40 35 25 12 sphere",
            "wholly outside the 96x54 image",
        ),
        (
            "3 1 20 10 50 40 35 25 12 sphere",
            "class 1 but dataset.toml has 1",
        ),
        ("3 0 20 10 50 40 35 25 0 sphere", "the distance is 0 m"),
        ("3 0 20 10 50 40 35 25 -5 sphere", "the distance is -5 m"),
        (
            "3 0 20 10 50 40 35 25 12 round",
            "'round' is not a value for 'kind'",
        ),
        ("3 0 20 10 50 40 35 25 12", "'kind' is missing"),
        (
            "3 0 20 10 50 40 35 25 12 sphere 1.5",
            "visible fraction is 1.5",
        ),
        ("3 0 20 10 50 40 35 25 12 sphere 1 9", "surplus field '9'"),
        (
            "-3 0 20 10 50 40 35 25 12 sphere",
            "'-3' is not a value for 'id'",
        ),
    ] {
        let fixture = Fixture::new(3);
        fixture.write("frames/left_00002.txt", &format!("# id class\n\n{line}\n"));
        assert_frame_2_is_reported(&fixture, &["left_00002.txt line 3", words]);
    }
}

#[test]
fn contradictions_between_labels_of_a_vehicle_are_reported() {
    let good = "3 0 20 10 50 40 35 25 12 sphere\n";
    let fixture = Fixture::new(3);
    fixture.write("frames/left_00002.txt", &format!("{good}{good}"));
    assert_frame_2_is_reported(&fixture, &["line 2", "vehicle 3 has two sphere labels"]);

    let fixture = Fixture::new(3);
    fixture.write("frames/left_00002.txt", &good.replace(" 12 ", " 13 "));
    assert_frame_2_is_reported(&fixture, &["vehicle 3 has distances 13 m and 12 m"]);

    let fixture = Fixture::new(3);
    fixture.edit("dataset.toml", "[\"car\"]", "[\"car\", \"bus\"]");
    fixture.write("frames/left_00002.txt", &good.replace("3 0 ", "3 1 "));
    assert_frame_2_is_reported(&fixture, &["vehicle 3 has classes 1 and 0"]);
}

#[test]
fn a_label_file_that_is_no_text_is_reported() {
    let fixture = Fixture::new(3);
    fs::write(fixture.path("frames/left_00002.txt"), [0xff, 0xfe, 0x00]).unwrap();
    assert_frame_2_is_reported(&fixture, &["left_00002.txt cannot be read"]);
}

#[test]
fn duplicate_and_ambiguous_frames_are_reported_and_none_of_them_is_used() {
    let fixture = Fixture::new(3);
    fixture.edit("frames.csv", "00002,", "00002,val,,,,,,\n2,");
    assert_frame_2_is_reported(&fixture, &["more than one row"]);

    let fixture = Fixture::new(3);
    fs::copy(
        fixture.path("frames/left_00002.png"),
        fixture.path("frames/left_000002.PNG"),
    )
    .unwrap();
    assert_frame_2_is_reported(&fixture, &["several left images", "left_000002.PNG"]);

    let fixture = Fixture::new(3);
    fixture.edit("frames.csv", "00002,train,1,noon,side,35,,12\n", "");
    assert_frame_2_is_reported(&fixture, &["no row in frames.csv"]);
}

#[test]
fn bad_rows_of_frames_csv_are_reported_by_line() {
    for (field, spoiled, word) in [
        (",12\n", ",NaN\n", "distance_m is NaN"),
        (",12\n", ",-12\n", "distance_m is -12"),
        ("00002,train", "00002,learn", "learn"),
        ("00002,train", "two,train", "column 'stamp'"),
        (",12\n", ",12,5,6\n", "has 10 fields where the header has 8"),
    ] {
        let fixture = Fixture::new(3);
        fixture.edit("frames.csv", field, spoiled);
        let dataset = fixture.open();
        assert_eq!(dataset.frames.len(), 2, "{:?}", dataset.problems);
        let text = dataset.problems[0].to_string();
        assert!(
            text.starts_with("frames.csv line 3: ") && text.contains(word),
            "{text}"
        );
    }
}

#[test]
fn a_vehicle_in_one_image_only_is_no_pair_and_no_problem() {
    let fixture = Fixture::new(3);
    fixture.write("frames/left_00002.txt", "# nothing to see\n");
    let dataset = fixture.open();
    assert!(dataset.problems.is_empty());
    let frame = dataset.frame(2).unwrap();
    assert!(frame.vehicles(BoxKind::Sphere).is_empty());
    assert_eq!(
        frame
            .right
            .as_ref()
            .unwrap()
            .boxes(BoxKind::Sphere, &dataset.rig().right)
            .len(),
        1
    );
}

#[test]
fn a_box_partly_outside_is_kept_and_clipped_for_detection() {
    let fixture = Fixture::new(1);
    fixture.write(
        "frames/left_00001.txt",
        "3 0 -20 -10.5 30 40 5 15 11 sphere\n",
    );
    let dataset = fixture.open();
    let left = &dataset.frames[0].left;
    assert_eq!(left.labels[0].box_pixel.x_min, -20.0);
    let boxes = left.boxes(BoxKind::Sphere, &dataset.rig().left);
    assert_eq!(
        boxes,
        [(0, crate::geometry::PixelBox::new(0.0, 0.0, 30.0, 40.0))]
    );
    assert_eq!(dataset.frames[0].vehicles(BoxKind::Sphere).len(), 1);
}

#[test]
fn stamps_may_have_any_length_and_images_may_be_jpeg() {
    let fixture = Fixture::new(1);
    for side in ["left", "right"] {
        let old = |extension: &str| fixture.path(&format!("frames/{side}_00001.{extension}"));
        let new =
            |extension: &str| fixture.path(&format!("frames/{side}_1718035200123.{extension}"));
        picture(1, side).save(new("jpg")).unwrap();
        fs::rename(old("txt"), new("txt")).unwrap();
        fs::remove_file(old("png")).unwrap();
    }
    fixture.edit("frames.csv", "00001,", "1718035200123,");
    let dataset = fixture.open();
    assert_eq!(dataset.frames[0].name(), "1718035200123");
    dataset.frames[0].load(dataset.rig()).unwrap();
}

#[test]
fn broken_and_wrongly_sized_images_are_found_by_the_image_check() {
    let fixture = Fixture::new(4);
    let path = fixture.path("frames/left_00002.png");
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    save_png(
        fixture.path("frames/right_00003.png"),
        &image::RgbImage::new(95, 54),
    )
    .unwrap();
    let mut dataset = fixture.open();
    assert!(dataset.problems.is_empty());
    dataset.check_images(&Silent).unwrap();
    let texts: Vec<_> = dataset.problems.iter().map(ToString::to_string).collect();
    assert!(
        texts[0].starts_with("frame 00002") && texts[0].contains("left_00002.png"),
        "{texts:?}"
    );
    assert!(
        texts[1].contains("95x54") && texts[1].contains("96x54"),
        "{texts:?}"
    );
    assert_eq!(dataset.frames.len(), 2);
}

#[test]
fn folders_that_are_no_dataset_are_refused_with_a_remedy() {
    let fixture = Fixture::new(1);
    let message = StereoDataset::open(fixture.path("nowhere"))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("is no folder; check the path"),
        "{message}"
    );
    fixture.edit("dataset.toml", "version = 1", "version = 2\nlenses = 3");
    assert!(fixture.refusal().contains("version = 2, not 1"));
    fixture.edit("dataset.toml", "version = 2\nlenses = 3", "version = 1");
    fixture.edit("dataset.toml", "baseline_m = 0.8", "baseline_m = 0.0");
    let message = fixture.refusal();
    assert!(
        message.contains("line 4") && message.contains("baseline_m = 0"),
        "{message}"
    );
    fixture.edit("dataset.toml", "baseline_m = 0.0", "baseline_m = ");
    assert!(
        fixture.refusal().contains("line 8"),
        "{}",
        fixture.refusal()
    );
    fixture.edit("dataset.toml", "baseline_m = ", "baseline_m = 0.8");
    fixture.edit("frames.csv", "stamp,", "number,");
    assert!(fixture.refusal().contains("no column 'stamp'"));
    fixture.remove("frames.csv");
    assert!(fixture.refusal().contains("has no frames.csv"));
    fixture.remove("dataset.toml");
    assert!(fixture.refusal().contains("has no dataset.toml"));
}

#[test]
fn a_dataset_without_a_usable_frame_is_refused_with_the_first_reasons() {
    let fixture = Fixture::new(5);
    for stamp in 1..=5 {
        fixture.remove(&format!("frames/left_{stamp:05}.png"));
    }
    let message = fixture.refusal();
    for word in [
        "none of its 5 frames",
        "frame 00001: the left image is missing",
        "and 2 more",
    ] {
        assert!(message.contains(word), "{message} should contain {word}");
    }
    fixture.write("frames.csv", "stamp,split\n");
    assert!(fixture.refusal().contains("lists no frames"));
}

#[test]
fn ignored_and_one_sided_vehicles_are_no_pairs_and_are_not_judged() {
    let fixture = Fixture::new(2);
    for side in ["left", "right"] {
        let path = format!("frames/{side}_00001.txt");
        let text = std::fs::read_to_string(fixture.path(&path)).unwrap();
        let more = |id: u32, end: &str| {
            let lines: Vec<String> = text
                .lines()
                .filter_map(|line| line.strip_prefix("3 "))
                .map(|rest| format!("{id} {rest}{end}"))
                .collect();
            lines.join("\n") + "\n"
        };
        let one_sided = if side == "left" {
            more(5, "")
        } else {
            String::new()
        };
        // Vehicle 4 is ignored in the right image only.
        let ignored = more(4, if side == "right" { " ignored" } else { "" });
        fixture.write(&path, &format!("{text}{ignored}{one_sided}"));
    }
    let dataset = fixture.open();
    let (frame, rig) = (&dataset.frames[0], dataset.rig());
    let kind = BoxKind::Tight;
    let ids: Vec<u32> = frame.vehicles(kind).iter().map(|v| v.id).collect();
    assert_eq!(ids, [3]);
    assert_eq!(frame.left.boxes(kind, &rig.left).len(), 3);
    let right = frame.right.as_ref().unwrap();
    assert_eq!(right.boxes(kind, &rig.right).len(), 1);
    assert_eq!(right.ignored_boxes(kind, &rig.right).len(), 1);
    assert_eq!(frame.unjudged_boxes(kind, Side::Left).len(), 2);
    assert_eq!(frame.unjudged_boxes(kind, Side::Right).len(), 1);
}
