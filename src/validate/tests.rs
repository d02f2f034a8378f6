use super::*;
use crate::dataset::fixture::{Fixture, HEIGHT, WIDTH};
use crate::progress::Silent;

/// The kinds that are found after a change to a sound dataset, and all reasons in one text.
fn found(spoil: impl FnOnce(&Fixture)) -> (Vec<FindingKind>, String) {
    let fixture = Fixture::lawful(5);
    spoil(&fixture);
    let validation = validate(fixture.root(), &Silent).unwrap();
    let text: Vec<String> = validation
        .findings
        .iter()
        .map(ToString::to_string)
        .collect();
    (validation.counts.into_keys().collect(), text.join("\n"))
}

/// Gives frame 1 images of a scene whose disparity is the same everywhere, pixels.
fn show_moved(fixture: &Fixture, disparity_px: u32) {
    for (side, moved) in [("left", 0), ("right", disparity_px)] {
        let image = image::RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            let seed = u64::from((x + moved) * 1000 + y);
            image::Rgb([(crate::world::noise::derive_seed(1, 2, seed) % 256) as u8; 3])
        });
        let path = fixture.path(&format!("frames/{side}_00001.png"));
        crate::imaging::save_png(path, &image).unwrap();
    }
}

#[test]
fn a_vehicle_that_something_hides_from_one_camera_needs_no_partner() {
    let (kinds, text) = found(|f| {
        // The other image shows something else there.
        show_moved(f, 30);
        f.write("frames/right_00001.txt", "# nothing\n");
    });
    assert!(kinds.is_empty(), "{text}");
}

#[test]
fn what_hides_parts_of_a_vehicle_moves_its_tight_boxes_and_a_wrong_box_is_still_found() {
    // A box of 12.8 pixels in the left image; in the right one, of which the disparity is 4.3, it is
    // seen from x = 50 on.
    let with_right = |box_and_rest: &str| {
        let (left, right) = (
            "0 0 30.4 29 60.4 41 45.4 35 9 tight 1\n",
            format!("0 0 {box_and_rest}\n"),
        );
        found(|f| {
            let center = "41.1333 35 9 tight";
            f.write("frames/left_00001.txt", left);
            f.write("frames/right_00001.txt", &right.replace('C', center));
            f.edit("frames.csv", ",9.2736", ",9");
        })
    };
    for hidden in [
        "44 29 56 41 C 0.4",
        "44 29 56 41 C 0.4 ignored",
        "36 29 56 41 C 0.6",
    ] {
        let (kinds, text) = with_right(hidden);
        assert!(!kinds.contains(&FindingKind::Disparity), "{hidden}: {text}");
    }
    for wrong in ["46 29 76 41 C 1", "46 29 76 41 C", "76 29 94 41 C 0.6"] {
        let (kinds, text) = with_right(wrong);
        assert!(kinds.contains(&FindingKind::Disparity), "{wrong}: {text}");
    }
}

#[test]
fn an_unknown_distance_is_no_mistake_and_is_counted_once_for_the_dataset() {
    let fixture = Fixture::lawful(5);
    for side in ["left", "right"] {
        let path = format!("frames/{side}_00001.txt");
        let text = std::fs::read_to_string(fixture.path(&path)).unwrap();
        let unknown: Vec<String> = text
            .lines()
            .map(|line| {
                let mut fields: Vec<&str> = line.split(' ').collect();
                if !line.starts_with('#') {
                    fields[8] = "-";
                }
                fields.join(" ")
            })
            .collect();
        fixture.write(&path, &unknown.join("\n"));
    }
    let validation = validate(fixture.root(), &Silent).unwrap();
    assert!(validation.findings.is_empty(), "{:?}", validation.findings);
    assert_eq!(validation.notes.len(), 1, "{:?}", validation.notes);
    assert!(
        validation.notes[0].starts_with("8 of "),
        "{:?}",
        validation.notes
    );
}

#[test]
fn a_sound_dataset_has_no_findings() {
    let (kinds, text) = found(|_| ());
    assert!(kinds.is_empty(), "{text}");
}

#[test]
fn every_defect_is_found_as_what_it_is() {
    use FindingKind as Kind;
    // A kind, a part of the reason, and what spoils the dataset.
    type Spoil = fn(&Fixture);
    let cases: [(Kind, &str, Spoil); 11] = [
        (Kind::Unusable, "right label file is missing", |f| {
            f.remove("frames/right_00002.txt");
        }),
        (Kind::Image, "truncated", |f| {
            let png = std::fs::read(f.path("frames/left_00003.png")).unwrap();
            std::fs::write(f.path("frames/left_00003.png"), &png[..png.len() / 2]).unwrap();
        }),
        (Kind::Image, "once more", |f| {
            std::fs::copy(
                f.path("frames/left_00003.png"),
                f.path("frames/right_00003.png"),
            )
            .unwrap();
        }),
        (Kind::Label, "promises tight boxes", |f| {
            for stamp in 1..=5 {
                for side in ["left", "right"] {
                    let path = format!("frames/{side}_{stamp:05}.txt");
                    let text = std::fs::read_to_string(f.path(&path)).unwrap();
                    let kept: Vec<_> = text.lines().filter(|l| !l.contains("tight")).collect();
                    f.write(&path, &kept.join("\n"));
                }
            }
        }),
        (Kind::Label, "not a square", |f| {
            f.write("frames/left_00001.txt", "7 0 10 10 40 30 25 20 - sphere ignored\n7 0 10 10 40 30 25 20 - tight ignored\n8 0 10 10 40 30 25 20 9.2736 sphere 0.3\n");
            f.write("frames/right_00001.txt", "");
        }),
        (Kind::Partner, "image alone", |f| {
            show_moved(f, 4);
            f.write("frames/right_00001.txt", "# nothing\n");
        }),
        (Kind::Disparity, "swapped", |f| {
            for name in ["left", "right"] {
                let from = f.path(&format!("frames/{name}_00001.txt"));
                std::fs::rename(from, f.path(name)).unwrap();
            }
            std::fs::rename(f.path("left"), f.path("frames/right_00001.txt")).unwrap();
            std::fs::rename(f.path("right"), f.path("frames/left_00001.txt")).unwrap();
        }),
        (Kind::Row, "no vehicle is there", |f| {
            f.edit(
                "frames.csv",
                "00001,train,1,noon,,17.5,,",
                "00001,train,1,noon,,17.5,,5",
            );
        }),
        (Kind::Split, "1 of 4 scenes", |f| {
            f.edit("frames.csv", "00004,val,4", "00004,val,1");
        }),
        (Kind::NearDuplicate, "looks like frame 00001", |f| {
            std::fs::copy(
                f.path("frames/left_00001.png"),
                f.path("frames/left_00004.png"),
            )
            .unwrap();
        }),
        (Kind::Leftover, "belongs to no frame", |f| {
            f.write("frames/notes.txt", "x");
        }),
    ];
    for (kind, reason, spoil) in cases {
        let (kinds, text) = found(spoil);
        assert_eq!(kinds, [kind], "{reason}: {text}");
        assert!(text.contains(reason), "{reason}: {text}");
    }
}

#[test]
fn a_rig_of_another_focal_length_or_with_a_tilted_camera_contradicts_the_labels() {
    let (kinds, text) = found(|f| f.edit("dataset.toml", "hfov_deg = 90.0", "hfov_deg = 60.0"));
    assert!(kinds.contains(&FindingKind::Disparity), "{text}");
    let (kinds, text) = found(|f| {
        let rig = "[rig.left]\nfocal_x_px = 48.0\nfocal_y_px = 48.0\ncenter_x_px = 48.0\n\
                   center_y_px = 27.0\n[rig.right]\nfocal_x_px = 48.0\nfocal_y_px = 48.0\n\
                   center_x_px = 48.0\ncenter_y_px = 30.0\n[made_by]";
        f.edit("dataset.toml", "hfov_deg = 90.0\n", "");
        f.edit("dataset.toml", "[made_by]", rig);
    });
    assert_eq!(kinds, [FindingKind::Rows], "{text}");
}

#[test]
fn composites_of_other_labels_are_found() {
    let (kinds, text) = found(|f| {
        let size = crate::dataset::CompositeSize::new(324, 162).unwrap();
        crate::dataset::prepare(&f.open(), crate::dataset::BoxKind::Sphere, size, &Silent).unwrap();
    });
    assert!(kinds.is_empty(), "{text}");
    let (kinds, text) = found(|f| {
        let size = crate::dataset::CompositeSize::new(324, 162).unwrap();
        crate::dataset::prepare(&f.open(), crate::dataset::BoxKind::Sphere, size, &Silent).unwrap();
        f.edit("frames.csv", "00004,val", "00004,train");
    });
    assert_eq!(kinds, [FindingKind::Composite], "{text}");
}
