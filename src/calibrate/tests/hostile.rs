//! Recordings that say nothing of a rig.

use image::{Rgb, RgbImage};

use super::scene::{SIZE, Wrong, calibrated, frame, frames, pair, rig};
use super::*;
use crate::error::Error;
use crate::sources::StereoFrame;

fn refusal(frames: Vec<StereoFrame>, known: &[KnownDistance]) -> String {
    let options = SurveyOptions::default();
    let found = survey(frames.into_iter(), &calibrated(), known, options, &Silent);
    match found {
        Err(error) => error.to_string(),
        Ok(found) => RectificationFit::new(&found.matches, &rig())
            .unwrap_err()
            .to_string(),
    }
}

#[test]
fn one_image_twice_is_named() {
    let [left, _] = pair(0, Wrong::default());
    let twice = refusal(vec![frame(0, [left.clone(), left.clone()])], &[]);
    assert!(twice.contains("are the same"), "{twice}");
    // Compressed anew, or brightened.
    let mut other = left.clone();
    for value in other.iter_mut() {
        *value = value.saturating_add(3);
    }
    let twice = refusal(vec![frame(0, [left, other])], &[]);
    assert!(twice.contains("are the same"), "{twice}");
}

#[test]
fn exchanged_images_are_named() {
    let exchanged = frames(2, Wrong::default()).into_iter().map(|mut frame| {
        frame.images = frame.images.map(|[left, right]| [right, left]);
        frame
    });
    let message = refusal(exchanged.collect(), &[]);
    assert!(message.contains("look exchanged"), "{message}");
    assert!(message.contains("left camera's images first"), "{message}");
}

#[test]
fn images_without_texture_and_unrelated_images_have_too_few_features() {
    let plain = || RgbImage::from_fn(SIZE[0], SIZE[1], |x, _| Rgb([(x / 4) as u8; 3]));
    let mut other = plain();
    other.put_pixel(3, 3, Rgb([255; 3]));
    let message = refusal(vec![frame(0, [plain(), other])], &[]);
    assert!(message.contains("too few"), "{message}");
    let unrelated = [pair(0, Wrong::default()), pair(1, Wrong::default())];
    let [[left, _], [_, right]] = unrelated;
    let message = refusal(vec![frame(0, [left, right])], &[]);
    assert!(
        message.contains("0 features") || message.contains("too few"),
        "{message}"
    );
}

#[test]
fn pairs_of_other_sizes_are_left_out_and_told_when_there_are_no_others() {
    let small = || RgbImage::new(320, 144);
    let message = refusal(vec![frame(0, [small(), small()])], &[]);
    assert!(message.contains("none can be used"), "{message}");
    assert!(message.contains("320x144"), "{message}");
    let broken = StereoFrame {
        images: Err(Error::image("right.png", "is truncated", "copy it again")),
        ..frame(0, [small(), small()])
    };
    let mut mixed = frames(3, Wrong::default());
    mixed.push(frame(3, [small(), small()]));
    mixed.push(broken);
    let options = SurveyOptions::default();
    let found = survey(mixed.into_iter(), &calibrated(), &[], options, &Silent).unwrap();
    assert_eq!((found.frames.len(), found.unusable.len()), (3, 2));
    assert!(
        found.unusable[1].contains("truncated"),
        "{:?}",
        found.unusable
    );
    assert!(refusal(Vec::new(), &[]).contains("there are none"));
}

#[test]
fn known_distances_of_no_pair_are_named_and_wrong_ones_are_not_measured() {
    let one = |image: &str, pixel: [f64; 2], distance_m: f64| KnownDistance {
        line: 7,
        image: image.to_owned(),
        target: Target::Point(pixel),
        distance_m,
        distance_std_m: 0.1,
    };
    let message = refusal(
        frames(1, Wrong::default()),
        &[one("00009", [50.0, 50.0], 9.0)],
    );
    assert!(
        message.contains("line 7") && message.contains("00009"),
        "{message}"
    );

    let pixel = [100.0, 60.0];
    let truth = distance_m(0, pixel);
    let known = [
        one("left_00000.png", pixel, truth),
        one("left_00000", pixel, truth / 4.0),
        one("in/left_00000.png", [900.0, 60.0], truth),
        one("00000", pixel, 0.05),
    ];
    let frames = frames(1, Wrong::default()).into_iter();
    let options = SurveyOptions::default();
    let found = survey(frames, &calibrated(), &known, options, &Silent).unwrap();
    assert_eq!(found.readings.len(), 1, "{:?}", found.readings);
    let reading = &found.readings[0];
    assert!(
        (reading.measured_px - reading.expected_px).abs() < 0.2,
        "{reading:?}"
    );
    let all = found.unread.join("\n");
    for words in [
        "nothing in the right image",
        "outside the image",
        "as near as that",
    ] {
        assert!(all.contains(words), "{all}");
    }
}

#[test]
fn a_stop_is_obeyed() {
    struct Stop;
    impl crate::progress::Progress for Stop {
        fn begin(&self, _: &str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn status(&self, _: &str) {}
        fn note(&self, _: &str) {}
        fn end(&self) {}
        fn interrupted(&self) -> bool {
            true
        }
    }
    let frames = frames(1, Wrong::default()).into_iter();
    let stopped = survey(frames, &calibrated(), &[], SurveyOptions::default(), &Stop);
    assert!(matches!(stopped, Err(Error::Interrupted { .. })));
}
