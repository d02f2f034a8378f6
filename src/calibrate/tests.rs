//! Rigs that are wrong by known amounts, and recordings that are none.

mod hostile;
mod scene;

use super::*;
use crate::calibration::{CalibratedRig, LoadOptions, RigOptions, from_text, to_toml};
use crate::geometry::DisparityCorrection;
use crate::progress::Silent;
use scene::{SIZE, Wrong, calibrated, calibration, distance_m, frames, rig};

/// Pairs that a rig is judged by.
const FRAMES: u64 = 4;

fn surveyed(wrong: Wrong) -> Survey {
    survey(
        frames(FRAMES, wrong).into_iter(),
        &calibrated(),
        &[],
        SurveyOptions::default(),
        &Silent,
    )
    .unwrap()
}

fn fitted(wrong: Wrong) -> RectificationFit {
    RectificationFit::new(&surveyed(wrong).matches, &rig()).unwrap()
}

/// Refuses a value that is further than three standard errors from the truth, and one that claims to
/// know next to nothing.
fn check(name: &str, estimate: Estimate, truth: f64, loosest: f64) {
    let Estimate { value, std } = estimate;
    assert!(
        (value - truth).abs() < 3.0 * std,
        "{name} {value} ± {std}, true {truth}"
    );
    assert!(std < loosest, "{name} ± {std}");
}

/// All of what is told, against what is wrong.
fn check_all(fit: &RectificationFit, wrong: Wrong) {
    let [pitch, yaw, roll] = wrong.turn_deg;
    let rows = wrong.shift_px[1] - rig().focal_px() * libm::tan(pitch.to_radians());
    check("rows", fit.row_offset_px, rows, 0.03);
    check("pitch", fit.pitch_deg, -pitch, 0.1);
    check("roll", fit.roll_deg, roll, 0.01);
    check("yaw", fit.yaw_deg, yaw, 0.05);
    check("focal", fit.focal_percent, 100.0 * wrong.focal, 0.1);
    let rise = -100.0 * wrong.aside_m[1] / 0.5;
    check("rise", fit.rise_percent, rise, 0.3);
    check("bend", fit.bend_px, 0.0, 0.15);
}

#[test]
fn a_good_rig_is_told_to_be_good() {
    let fit = fitted(Wrong::default());
    check_all(&fit, Wrong::default());
    assert!(fit.matches > 1500 && fit.frames == 4, "{}", fit.matches);
    assert!(fit.outliers * 10 < fit.matches, "{}", fit.outliers);
    assert!(fit.sigma_px < 0.15 && fit.rows_off_px < 0.1, "{fit:?}");
}

#[test]
fn shifted_rows_are_recovered() {
    let wrong = Wrong {
        shift_px: [0.0, 0.6],
        ..Wrong::default()
    };
    let fit = fitted(wrong);
    check("rows", fit.row_offset_px, 0.6, 0.03);
    check("roll", fit.roll_deg, 0.0, 0.01);
    check("yaw", fit.yaw_deg, 0.0, 0.05);
}

#[test]
fn turns_are_recovered_one_by_one_and_together() {
    for turn_deg in [
        [0.1, 0.0, 0.0],
        [0.0, 0.3, 0.0],
        [0.0, 0.0, 0.2],
        [-0.08, -0.2, -0.15],
    ] {
        let wrong = Wrong {
            turn_deg,
            ..Wrong::default()
        };
        check_all(&fitted(wrong), wrong);
    }
}

#[test]
fn another_focal_length_and_another_height_are_recovered() {
    let wrong = Wrong {
        focal: 0.003,
        aside_m: [0.0, -0.006, 0.0],
        ..Wrong::default()
    };
    check_all(&fitted(wrong), wrong);
}

/// Points of the left image with their distances, as a user would measure them.
fn known(street: u64) -> Vec<KnownDistance> {
    let mut known = Vec::new();
    for i in 0..24 {
        let pixel = [
            30.0 + 580.0 * f64::from(i % 8) / 7.0,
            60.0 + 80.0 * f64::from(i / 8),
        ];
        // Where surfaces end, nobody measures.
        let around = [[-12.0, -12.0], [12.0, -12.0], [-12.0, 12.0], [12.0, 12.0]];
        let distance = distance_m(street, pixel);
        let is_smooth = around.iter().all(|[dx, dy]| {
            let other = distance_m(street, [pixel[0] + dx, pixel[1] + dy]);
            (other / distance - 1.0).abs() < 0.15
        });
        if is_smooth {
            known.push(KnownDistance {
                line: known.len() as u64 + 2,
                image: format!("{street:05}"),
                target: Target::Point(pixel),
                distance_m: distance,
                distance_std_m: 0.002 * distance,
            });
        }
    }
    known
}

const TURNED: Wrong = Wrong {
    turn_deg: [0.0, 0.3, 0.05],
    shift_px: [-1.8, 0.0],
    focal: 0.0,
    aside_m: [0.0; 3],
};

/// Everything from images to the correction.
fn corrected(wrong: Wrong) -> (Refined, KnownOffset) {
    let known: Vec<_> = (0..2).flat_map(known).collect();
    assert!(known.len() >= 16, "{}", known.len());
    let options = SurveyOptions::default();
    let frames = frames(FRAMES, wrong).into_iter();
    let found = survey(frames, &calibrated(), &known, options, &Silent).unwrap();
    assert!(found.readings.len() >= 12, "{:?}", found.unread);
    let fit = RectificationFit::new(&found.matches, &found.rig).unwrap();
    let refined = Refined::new(
        &calibration(),
        RigOptions::default(),
        &calibrated(),
        &found,
        &fit,
    )
    .unwrap();
    let offset = offset_from_readings(&refined.readings, &refined.fit, &refined.rig).unwrap();
    (refined, offset)
}

#[test]
fn known_distances_find_the_constant_that_rows_do_not_show() {
    let (refined, offset) = corrected(TURNED);
    assert!(!refined.is_turned);
    // A turn moves what is seen far away to the right by focal (tan yaw) at the middle.
    let yaw = TURNED.turn_deg[1].to_radians();
    let truth = 1.8 - rig().focal_px() * libm::tan(yaw);
    let terms = offset.terms;
    check(
        "constant",
        Estimate {
            value: terms.constant_px,
            std: terms.constant_std_px,
        },
        truth,
        0.1,
    );
    let curvature = -rig().focal_px() * libm::tan(yaw);
    assert!(
        (terms.xx_px - curvature).abs() < 0.4,
        "{terms:?}, {curvature}"
    );
    assert!(
        offset.rms_px < 0.15 && offset.doubtful.is_empty(),
        "{offset:?}"
    );
}

#[test]
fn a_correction_of_rows_alone_has_the_shape_of_the_true_error() {
    let shape = fitted(TURNED).shape(0.5);
    let correction = DisparityCorrection::new(shape, rig().left).unwrap();
    assert_eq!(correction.delta_px([320.0, 144.0]), 0.0);
    // Far points, seen by the right camera as it is and as it should be.
    let true_px = |pixel: [f64; 2]| {
        let [x, y, _] = rig().left.camera_from_pixel(pixel);
        let turn = glam::DVec3::from_array(TURNED.turn_deg.map(f64::to_radians));
        let seen = glam::DQuat::from_scaled_axis(turn) * glam::DVec3::new(x, y, 1.0);
        rig().focal_px() * (x - seen.x / seen.z)
    };
    let middle = true_px([320.0, 144.0]);
    for pixel in [
        [0.0, 0.0],
        [640.0, 0.0],
        [0.0, 288.0],
        [640.0, 288.0],
        [480.0, 50.0],
    ] {
        let truth = true_px(pixel) - middle;
        let found = correction.delta_px(pixel);
        assert!(
            (found - truth).abs() < 3.0 * shape.shape_std_px,
            "{pixel:?}: {found}, {truth}"
        );
    }
}

#[test]
fn rows_that_are_far_off_are_mended_by_turning_the_camera() {
    let wrong = Wrong {
        turn_deg: [0.35, 0.2, -0.4],
        shift_px: [0.0, 0.5],
        aside_m: [0.0, 0.01, 0.0],
        ..Wrong::default()
    };
    let (refined, offset) = corrected(wrong);
    assert!(
        refined.is_turned && refined.fit.rows_off_px < 0.3,
        "{:?}",
        refined.fit
    );
    assert!(offset.rms_px < 0.15, "{offset:?}");

    // The file as written, read again and used on the images.
    let written = refined.with_correction(offset.terms).unwrap();
    let read = from_text(&to_toml(&written).unwrap(), &LoadOptions::default()).unwrap();
    let mended = CalibratedRig::new(&read, SIZE, RigOptions::default()).unwrap();
    assert!(mended.rectifies());
    let frames = frames(FRAMES, wrong).into_iter();
    let found = survey(frames, &mended, &[], SurveyOptions::default(), &Silent).unwrap();
    let fit = RectificationFit::new(&found.matches, &found.rig).unwrap();
    assert!(fit.rows_off_px < 0.3, "{fit:?}");
    let correction = mended.disparity_correction().unwrap();
    assert_eq!(correction.terms(), &offset.terms);
}

#[test]
fn a_calibration_is_written_as_it_is_read() {
    let terms = fitted(TURNED).shape(0.5);
    for calibration in [
        calibration(),
        from_text(
            "width = 640\nheight = 288\ntranslation_m = [-0.5, 0.01, -0.02]\n\
             rotation = [[0.99995, 0.0, 0.01], [0.0, 1.0, 0.0], [-0.01, 0.0, 0.99995]]\n\
             [left]\nfocal_x_px = 500.25\nfocal_y_px = 501.0\ncenter_x_px = 322.5\n\
             center_y_px = 140.125\ndistortion = [-0.28, 0.08, 0.0012, -0.0001]\n\
             [right]\nfocal_x_px = 502.0\nfocal_y_px = 503.0\ncenter_x_px = 318.5\n\
             center_y_px = 141.5\n",
            &LoadOptions::default(),
        )
        .unwrap(),
    ] {
        let written = calibration.with_disparity_correction(Some(terms)).unwrap();
        let read = from_text(&to_toml(&written).unwrap(), &LoadOptions::default()).unwrap();
        assert_eq!(read, written);
    }
}

#[test]
fn the_picture_shows_the_rows_before_and_after() {
    let found = surveyed(TURNED);
    let fit = RectificationFit::new(&found.matches, &found.rig).unwrap();
    let svg = rows_picture(&found.matches, &fit, &found.rig).unwrap();
    for words in ["<svg", "before: rows", "after: rows", "column, px"] {
        assert!(svg.contains(words), "{words}");
    }
    assert!(!svg.contains("NaN"));
}
