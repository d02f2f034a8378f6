//! Datasets that grow, and runs that were stopped.

use std::collections::BTreeMap;
use std::fs;

use super::tests::{StopAfter, content, tiny};
use super::*;
use crate::dataset::StereoDataset;
use crate::progress::Silent;

/// The content without the file that says how it came about.
fn data(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut content = content(folder);
    content.remove("dataset.toml");
    content
}

#[test]
fn added_frames_change_nothing_of_what_was_there() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    generate(&tiny(), root, &Silent).unwrap();
    let before = content(root);
    let report = add_frames(5, root, None, &Silent).unwrap();
    assert_eq!((report.frames, report.reused), (11, 6));
    let after = content(root);
    for (name, bytes) in &before {
        match name.as_str() {
            "dataset.toml" => {}
            "frames.csv" | "objects.csv" => assert!(after[name].starts_with(bytes), "{name}"),
            _ => assert!(after[name] == *bytes, "{name}"),
        }
    }
    let dataset = StereoDataset::open(root).unwrap();
    assert!(dataset.problems.is_empty(), "{:?}", dataset.problems);
    let rows: Vec<_> = dataset.frames.iter().map(|frame| &frame.row).collect();
    assert_eq!(rows.len(), 11);
    let old_scenes: Vec<_> = rows[..6].iter().map(|row| row.scene).collect();
    assert!(rows[6..].iter().all(|row| !old_scenes.contains(&row.scene)));
    for split in [Split::Train, Split::Val] {
        assert!(rows[6..].iter().any(|row| row.split == split));
    }
    // The test frames of an addition would be no test of what was trained before.
    assert_eq!(report.test, 0);
}

#[test]
fn more_frames_in_the_settings_add_the_missing_ones_and_as_many_or_fewer_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [grown, added] = ["grown", "added"].map(|name| folder.path().join(name));
    for root in [&grown, &added] {
        generate(&tiny(), root, &Silent).unwrap();
    }
    let more = |frames| GenerateConfig { frames, ..tiny() };
    let report = generate(&more(9), &grown, &Silent).unwrap();
    assert_eq!((report.frames, report.reused), (9, 6));
    add_frames(3, &added, None, &Silent).unwrap();
    assert!(content(&grown) == content(&added));
    for frames in [9, 8] {
        let message = generate(&more(frames), &grown, &Silent)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("already holds these 9 frames"),
            "{message}"
        );
    }
    // A third part.
    let report = generate(&more(11), &grown, &Silent).unwrap();
    assert_eq!((report.frames, report.reused), (11, 9));
    let other = GenerateConfig {
        seed: 7,
        ..more(20)
    };
    let message = generate(&other, &grown, &Silent).unwrap_err().to_string();
    assert!(message.contains("never overwritten"), "{message}");
}

#[test]
fn an_addition_that_was_stopped_goes_on_with_the_same_number_only() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, stopped] = ["whole", "stopped"].map(|name| folder.path().join(name));
    for root in [&whole, &stopped] {
        generate(&tiny(), root, &Silent).unwrap();
    }
    let before = data(&stopped);
    add_frames(6, &whole, None, &Silent).unwrap();
    let error = add_frames(6, &stopped, None, &StopAfter::new(3)).unwrap_err();
    assert!(matches!(error, Error::Interrupted { .. }), "{error}");
    // What was there is still a dataset.
    let dataset = StereoDataset::open(&stopped).unwrap();
    assert_eq!(dataset.frames.len(), 6);
    let now = data(&stopped);
    assert!(before.iter().all(|(name, bytes)| now[name] == *bytes));

    let message = add_frames(4, &stopped, None, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("other settings"), "{message}");
    let report = add_frames(6, &stopped, None, &Silent).unwrap();
    assert!(report.reused > 6, "{report:?}");
    assert!(content(&whole) == content(&stopped));
}

#[test]
fn a_run_killed_at_any_of_its_last_steps_can_be_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    generate(&tiny(), root, &Silent).unwrap();
    let first = fs::read_to_string(root.join("dataset.toml")).unwrap();
    add_frames(4, root, None, &Silent).unwrap();
    let whole = content(root);
    let made_by = &whole["dataset.toml"];
    let text = std::str::from_utf8(made_by).unwrap();
    let table: toml::Table = text.parse().unwrap();
    let marker = toml::to_string(&table["made_by"]).unwrap();
    // Before and after dataset.toml was written, with a half-written file about.
    for dataset_toml in [&*first, text] {
        fs::write(root.join("generating.toml"), &marker).unwrap();
        fs::write(root.join("dataset.toml"), dataset_toml).unwrap();
        fs::write(root.join("frames/.twinsight-a1b2"), "half").unwrap();
        let report = add_frames(4, root, None, &Silent).unwrap();
        assert_eq!((report.frames, report.reused), (10, 10));
        assert!(content(root) == whole);
    }
}

#[test]
fn nothing_is_added_to_folders_that_the_generator_did_not_fill() {
    let folder = tempfile::tempdir().unwrap();
    let message = add_frames(4, folder.path(), None, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("holds no finished dataset"), "{message}");
    generate(&tiny(), folder.path(), &Silent).unwrap();
    // A user's own frame has taken the next stamp.
    let path = folder.path().join("frames.csv");
    let text = fs::read_to_string(&path).unwrap();
    fs::write(&path, format!("{text}00042,train,,,,,,\n")).unwrap();
    let message = add_frames(4, folder.path(), None, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("frame 00042"), "{message}");
    fs::write(&path, text).unwrap();
    let toml = folder.path().join("dataset.toml");
    let text = fs::read_to_string(&toml).unwrap();
    fs::write(&toml, text.replace("twinsight generate", "something else")).unwrap();
    let message = add_frames(4, folder.path(), None, &Silent)
        .unwrap_err()
        .to_string();
    assert!(message.contains("not made by this version"), "{message}");
}

#[test]
fn a_disk_that_is_too_small_is_refused_with_both_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let task = Task::generate(&tiny(), folder.path()).unwrap();
    let target = Target::open(task, folder.path()).unwrap();
    let sample = |bytes| Sample {
        scene: std::time::Duration::from_millis(100),
        frame: std::time::Duration::from_secs(2),
        bytes,
    };
    let work = Work {
        scenes: 10,
        frames: 100,
        threads: 2,
    };
    let words = announce(sample(1000), work, &target).unwrap();
    assert!(words.contains("about 3 minutes on 2 threads"), "{words}");
    let message = announce(sample(1 << 55), work, &target)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("needs about") && message.contains("are free"),
        "{message}"
    );
}
