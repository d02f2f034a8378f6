use super::*;
use crate::dataset::fixture::Fixture;
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
    let cases: [(Kind, &str, Spoil); 12] = [
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
        (Kind::Label, "has no distance", |f| {
            f.write("frames/left_00001.txt", "7 0 10 10 40 40 25 25 - sphere\n");
            f.write("frames/right_00001.txt", "");
        }),
        (Kind::Partner, "image alone", |f| {
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
