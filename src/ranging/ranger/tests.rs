use super::*;
use crate::geometry::{DisparityCorrection, DisparityTerms};

const SIZE: [u32; 2] = [640, 360];

fn rig() -> StereoRig {
    StereoRig::from_hfov(SIZE[0], SIZE[1], 90.0, 0.8).unwrap()
}

/// Waves in many directions: a texture that can be sampled anywhere.
fn texture(x: f64, y: f64) -> u8 {
    let waves = (0..16_u32).map(|wave| {
        let [a, b, c] = [1.7, 2.9, 4.3].map(|k| libm::sin(k * f64::from(wave + 1)));
        let along = x * libm::cos(3.0 * b) + y * libm::sin(3.0 * b);
        libm::sin(along / (2.5 + 1.5 * a) + 9.0 * c)
    });
    (128.0 + 16.0 * waves.sum::<f64>()).clamp(0.0, 255.0) as u8
}

/// A pair that shows one wall at a disparity.
fn pair(disparity_px: f64) -> [RgbImage; 2] {
    [0.0, disparity_px].map(|shift| {
        RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
            image::Rgb([texture(f64::from(x) + shift, f64::from(y)); 3])
        })
    })
}

fn target(box_pixel: PixelBox) -> Target {
    Target {
        box_pixel,
        kind: BoxKind::Tight,
        class: None,
        witness: None,
    }
}

/// A car seen from the side with its centre at a depth, metres.
fn car(z_m: f64) -> Target {
    let focal_px = rig().focal_px();
    // Its near side is half its width before its centre.
    let height_px = 1.52 * focal_px / (z_m - 0.85);
    let width_px = 4.2 * focal_px / z_m;
    target(PixelBox::from_center([330.0, 185.0], width_px, height_px))
}

/// One that knows nothing of sizes, at the surface itself.
const BROAD: SizeWitness = SizeWitness {
    log_size_mean: 1.0,
    log_size_std: 20.0,
    extent_mean_m: 0.0,
    extent_std_m: 1e-6,
    unknown: 0.0,
};

fn ranged(images: &[RgbImage; 2], target: &Target, rig: &TrustedRig) -> Ranged {
    let (mut ranged, _) =
        Ranger::default().posteriors(images.each_ref(), std::slice::from_ref(target), rig);
    ranged.pop().unwrap()
}

/// Width of the 95 % interval as a part of the median.
fn relative_width(ranged: &Ranged) -> f64 {
    let [low, high] = ranged.posterior.interval_m(0.95);
    (high - low) / ranged.posterior.median_m()
}

#[test]
fn with_a_broad_size_the_answer_is_the_triangulated_distance() {
    for z_m in [8.0, 14.3, 31.0] {
        let images = pair(rig().disparity_px(z_m));
        let target = Target {
            witness: Some(BROAD),
            ..car(z_m)
        };
        let ranged = ranged(&images, &target, &TrustedRig::exact(rig()));
        let expected_m = rig()
            .triangulated_m(target.box_pixel.center(), rig().disparity_px(z_m))
            .unwrap();
        // 0.05 px of disparity.
        let slack_m = 0.05 / rig().disparity_px(z_m) * z_m;
        let median_m = ranged.posterior.median_m();
        assert!(
            (median_m - expected_m).abs() < slack_m,
            "{median_m} at {expected_m}"
        );
        assert!(ranged.support > 0.9, "{}", ranged.support);
        assert_eq!(ranged.doubt, None);
    }
}

#[test]
fn a_vehicle_without_texture_has_the_posterior_of_its_size() {
    let grey = RgbImage::from_pixel(SIZE[0], SIZE[1], image::Rgb([90; 3]));
    let ranged = ranged(&[grey.clone(), grey], &car(20.0), &TrustedRig::exact(rig()));
    assert_eq!(ranged.stereo_m, None);
    let median_m = ranged.posterior.median_m();
    assert!(
        (median_m / ranged.size_m - 1.0).abs() < 0.01,
        "{median_m} and {}",
        ranged.size_m
    );
    assert!((median_m - 20.0).abs() < 2.0, "{median_m}");
    assert!(relative_width(&ranged) > 0.2);
}

#[test]
fn scaling_a_scene_and_its_baseline_leaves_the_disparity_evidence_as_it_is() {
    let images = pair(12.8);
    let area = car(20.0).box_pixel;
    let best: Vec<f64> = [1.0, 1.3, 1.7]
        .into_iter()
        .map(|scale| {
            let rig = StereoRig {
                baseline_m: 0.8 * scale,
                ..rig()
            };
            let evidence = stereo_evidence(images.each_ref(), &area, &[], &rig).unwrap();
            assert!(evidence.support > 0.9, "{}", evidence.support);
            evidence.best_px()
        })
        .collect();
    for best_px in &best {
        assert!((best_px - 12.8).abs() < 0.06, "{best:?}");
    }
}

#[test]
fn size_and_disparity_that_agree_are_surer_than_either() {
    let images = pair(rig().disparity_px(20.0 - 0.5));
    let rig = TrustedRig::exact(rig());
    let ranged = ranged(&images, &car(20.0), &rig);
    let median_m = ranged.posterior.median_m();
    // A car that is turned by up to 30 degrees is as wide, and its centre up to 0.6 m farther.
    assert!((median_m - 20.0).abs() < 0.8, "{median_m}");
    assert!(
        relative_width(&ranged) < 0.12,
        "{}",
        relative_width(&ranged)
    );
    let [low, high] = ranged.posterior.interval_m(0.68);
    assert!(low < median_m && median_m < high);
    assert_eq!(ranged.posterior.modes().len(), 1);
}

#[test]
fn a_correction_of_the_rig_is_subtracted_and_an_unchecked_rig_is_less_sure() {
    let true_px = rig().disparity_px(30.0);
    let images = pair(true_px + 0.6);
    let target = Target {
        witness: Some(BROAD),
        ..car(30.0)
    };
    let terms = DisparityTerms {
        focal_px: rig().focal_px(),
        constant_px: 0.6,
        constant_std_px: 0.05,
        x_px: 0.0,
        y_px: 0.0,
        xx_px: 0.0,
        xy_px: 0.0,
        shape_std_px: 0.0,
    };
    let correction = DisparityCorrection::new(terms, rig().left).unwrap();
    let corrected = ranged(&images, &target, &TrustedRig::corrected(rig(), correction));
    let unchecked = ranged(&images, &target, &TrustedRig::unchecked(rig()));
    let [corrected_m, unchecked_m] =
        [&corrected, &unchecked].map(|ranged| ranged.posterior.median_m());
    assert!((corrected_m - 30.0).abs() < 0.3, "{corrected_m}");
    assert!(unchecked_m < 29.0, "{unchecked_m}");
    assert!(relative_width(&unchecked) > 2.0 * relative_width(&corrected));
    // Its place in the right image is where the pixels are, error and all.
    assert!((corrected.disparity_px - (true_px + 0.6)).abs() < 0.2);
}

#[test]
fn images_that_are_no_pair_give_wide_intervals_and_say_why() {
    let [left, right] = pair(12.8);
    let rig = TrustedRig::exact(rig());
    let ranger = Ranger::default();
    let targets = [car(20.0)];
    let truth_m = 20.0;
    let (swapped, doubt) = ranger.posteriors([&right, &left], &targets, &rig);
    assert_eq!(
        doubt,
        Some(PairDoubt::Exchanged {
            vehicles: 1,
            found: 0,
            exchanged: 1
        })
    );
    let (same, identical) = ranger.posteriors([&left, &left], &targets, &rig);
    assert_eq!(identical, Some(PairDoubt::Identical));
    for ranged in swapped.iter().chain(&same) {
        let [low, high] = ranged.posterior.interval_m(0.95);
        assert!(low < truth_m && truth_m < high, "{low} to {high}");
        assert!(relative_width(ranged) > 0.3, "{low} to {high}");
    }
    assert_eq!(ranger.posteriors([&left, &right], &targets, &rig).1, None);
    let black = RgbImage::new(SIZE[0], SIZE[1]);
    assert_eq!(ranger.posteriors([&black, &black], &targets, &rig).1, None);
}

#[test]
fn boxes_and_rigs_that_say_nothing_give_wide_intervals() {
    let images = pair(12.8);
    let boxes = [
        PixelBox::from_center([300.0, 180.0], 1.0, 1.0),
        PixelBox::new(-80.0, -60.0, -20.0, -30.0),
        PixelBox::new(700.0, 400.0, 760.0, 430.0),
        PixelBox::new(10.0, 20.0, 10.0, 20.0),
        PixelBox::new(f64::NAN, 20.0, 40.0, 50.0),
        PixelBox::new(0.0, 0.0, 640.0, 360.0),
    ];
    for area in boxes {
        let ranged = ranged(&images, &target(area), &TrustedRig::exact(rig()));
        let [low, high] = ranged.posterior.interval_m(0.95);
        assert!(
            low.is_finite() && high.is_finite() && low < high,
            "{area:?}"
        );
        assert!(relative_width(&ranged) > 0.25, "{area:?}: {low} to {high}");
    }
    for (baseline_m, hfov_deg) in [(1e-9, 90.0), (1e6, 90.0), (0.8, 0.001), (0.8, 179.9)] {
        let rig = StereoRig::from_hfov(SIZE[0], SIZE[1], hfov_deg, baseline_m).unwrap();
        let ranged = ranged(&images, &car(20.0), &TrustedRig::exact(rig));
        let [low, high] = ranged.posterior.interval_m(0.95);
        assert!(low.is_finite() && high.is_finite() && low < high);
        assert!(
            relative_width(&ranged) > 0.2,
            "{baseline_m} m, {hfov_deg} deg: {low} to {high}"
        );
    }
}

#[test]
fn what_a_nearer_vehicle_hides_has_no_say() {
    // The lower right of the far car shows a near one at another disparity.
    let (far_px, near_px) = (rig().disparity_px(19.5), 21.0);
    let far = car(20.0);
    let near = PixelBox::new(
        far.box_pixel.center()[0] - 8.0,
        far.box_pixel.y_min + 4.0,
        far.box_pixel.x_max + 30.0,
        far.box_pixel.y_max + 20.0,
    );
    let [left, far_right] = pair(far_px);
    let [_, near_right] = pair(near_px);
    let shown = PixelBox::new(
        near.x_min - near_px,
        near.y_min,
        near.x_max - near_px,
        near.y_max,
    );
    let right = RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let (u, v) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        let is_near =
            (shown.x_min..shown.x_max).contains(&u) && (shown.y_min..shown.y_max).contains(&v);
        *(if is_near { &near_right } else { &far_right }).get_pixel(x, y)
    });
    let best_px = |nearer: &[PixelBox]| {
        stereo_evidence([&left, &right], &far.box_pixel, nearer, &rig())
            .unwrap()
            .at(near_px)
    };
    assert!(
        best_px(&[near]) < 0.3 * best_px(&[]),
        "{}",
        best_px(&[near])
    );
    let (ranged, _) = Ranger::default().posteriors(
        [&left, &right],
        &[far, target(near)],
        &TrustedRig::exact(rig()),
    );
    let median_m = ranged[0].posterior.median_m();
    assert!((median_m - 20.0).abs() < 0.8, "{median_m}");
}

#[test]
fn a_high_camera_is_told_by_several_vehicles() {
    // From 45 degrees above a car is seen as high as its height and its length make it.
    let rig = rig();
    let z_m = 20.0;
    let images = pair(rig.disparity_px(z_m - 0.7));
    let px = rig.focal_px() / z_m;
    let targets: Vec<Target> = [90.0, 250.0, 410.0, 560.0]
        .into_iter()
        .map(|x| target(PixelBox::from_center([x, 180.0], 1.9 * px, 3.6 * px)))
        .collect();
    let (ranged, _) =
        Ranger::default().posteriors(images.each_ref(), &targets, &TrustedRig::exact(rig));
    for (ranged, target) in ranged.iter().zip(&targets) {
        let expected_m = Ray::new(&target.box_pixel, &rig).distance_m(z_m);
        let median_m = ranged.posterior.median_m();
        assert!(
            (median_m / expected_m - 1.0).abs() < 0.04,
            "{median_m} at {expected_m}"
        );
    }
}
