use super::*;
use crate::geometry::{Intrinsics, RigSettings};

const SIZE: [u32; 2] = [640, 360];

fn rig() -> StereoRig {
    StereoRig::from_hfov(SIZE[0], SIZE[1], 90.0, 0.8).unwrap()
}

fn detection(center: [f64; 2], side: f64) -> Detection {
    Detection {
        box_pixel: PixelBox::from_center(center, side, side),
        score: 0.9,
        class: 0,
    }
}

/// A picture that is different everywhere and known between pixels too: waves of 6 to 60 pixels in
/// directions of their own.
fn texture(seed: u32, x: f64, y: f64) -> f64 {
    (0..12u32)
        .map(|wave| {
            let [a, b, c] = [1.7, 2.9, 4.3].map(|k| libm::sin(k * f64::from(wave + 100 * seed)));
            let length = 33.0 + 27.0 * a;
            let turn = std::f64::consts::PI * b;
            let along = x * libm::cos(turn) + y * libm::sin(turn);
            libm::sin(2.0 * std::f64::consts::PI * along / length + 9.0 * c)
        })
        .sum::<f64>()
        / 12.0
}

fn image(value: impl Fn(f64, f64) -> f64) -> RgbImage {
    RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let value = value(f64::from(x) + 0.5, f64::from(y) + 0.5);
        image::Rgb([value.round().clamp(0.0, 255.0) as u8; 3])
    })
}

/// The texture, moved left by a disparity.
fn moved(disparity_px: f64) -> RgbImage {
    image(|x, y| 128.0 + 250.0 * texture(1, x + disparity_px, y))
}

fn search_in(left: &RgbImage, right: &RgbImage, detections: &[Detection]) -> Searched {
    search([left, right], detections, &rig(), &PairingConfig::default())
}

/// The only partner of the only detection.
fn partner_in(left: &RgbImage, right: &RgbImage, detection: Detection) -> Partner {
    let searched = search_in(left, right, &[detection]);
    assert!(searched.left_only.is_empty());
    assert_eq!(searched.partners.len(), 1);
    searched.partners[0]
}

fn assert_refused(left: &RgbImage, right: &RgbImage, detection: Detection, why: &str) {
    let searched = search_in(left, right, &[detection]);
    assert_eq!(searched.partners, [], "{why}");
    assert_eq!(searched.left_only, [0], "{why}");
}

#[test]
fn whole_and_broken_shifts_are_recovered_to_a_tenth_of_a_pixel_in_boxes_of_all_sizes() {
    let left = moved(0.0);
    for disparity_px in [3.0, 8.25, 12.0, 17.5, 26.8] {
        let right = moved(disparity_px);
        for side in [14.0, 25.3, 60.0, 121.7, 240.0] {
            let detection = detection([330.2, 170.6], side);
            // A small box of a large disparity would be a toy, a large one of a small one a hall.
            if !(side * 0.8 / 40.0..=side * 0.8 / 0.5).contains(&disparity_px) {
                continue;
            }
            let partner = partner_in(&left, &right, detection);
            let error = partner.disparity_px - disparity_px;
            assert!(
                error.abs() < 0.1,
                "{side}: {disparity_px} is off by {error}"
            );
            assert!(partner.correlation > 0.97);
            let [x, y] = partner.box_pixel.center();
            assert!((x - (330.2 - partner.disparity_px)).abs() < 1e-9 && (y - 170.6).abs() < 1e-9);
            assert!((partner.box_pixel.width() - side).abs() < 1e-9);
        }
    }
}

#[test]
fn brightness_and_contrast_of_the_images_may_differ() {
    let left = moved(0.0);
    let dull = image(|x, y| 60.0 + 90.0 * texture(1, x + 11.4, y));
    let partner = partner_in(&left, &dull, detection([300.0, 150.0], 50.0));
    assert!((partner.disparity_px - 11.4).abs() < 0.1);
}

#[test]
fn images_that_are_two_rows_apart_are_forgiven() {
    let left = moved(0.0);
    for rows in [-2.0, 1.0, 2.0] {
        let right = image(|x, y| 128.0 + 250.0 * texture(1, x + 9.0, y + rows));
        for side in [24.0, 90.0] {
            let partner = partner_in(&left, &right, detection([300.0, 150.0], side));
            assert!((partner.disparity_px - 9.0).abs() < 0.1);
            assert!((partner.box_pixel.center()[1] - 150.0).abs() < 1e-9);
        }
    }
}

#[test]
fn cameras_of_different_focal_lengths_and_principal_points_see_the_same_disparity() {
    let intrinsics = |focal_px: f64, center: [f64; 2]| Intrinsics {
        focal_x_px: focal_px,
        focal_y_px: focal_px,
        center_x_px: center[0],
        center_y_px: center[1],
    };
    for (focal_px, center) in [
        (320.0, [351.3, 168.7]),
        (352.0, [290.0, 185.0]),
        (300.0, [320.0, 180.0]),
    ] {
        let rig: StereoRig = RigSettings {
            width: SIZE[0],
            height: SIZE[1],
            baseline_m: 0.8,
            hfov_deg: None,
            left: Some(intrinsics(320.0, [320.0, 180.0])),
            right: Some(intrinsics(focal_px, center)),
        }
        .try_into()
        .unwrap();
        // A wall at 20 m.
        let disparity_px = rig.disparity_px(20.0);
        let left = moved(0.0);
        let right = image(|x, y| {
            let scale = 320.0 / focal_px;
            let [x, y] = [
                320.0 + (x - center[0]) * scale,
                180.0 + (y - center[1]) * scale,
            ];
            128.0 + 250.0 * texture(1, x + disparity_px, y)
        });
        let detection = detection([340.0, 160.0], 64.0);
        let found = search(
            [&left, &right],
            &[detection],
            &rig,
            &PairingConfig::default(),
        );
        let partner = found.partners[0];
        assert!((partner.disparity_px - 12.8).abs() < 0.1, "{partner:?}");
        let scale = focal_px / 320.0;
        let [x, y] = partner.box_pixel.center();
        assert!((x - (center[0] + (340.0 - 320.0 - 12.8) * scale)).abs() < 0.15);
        assert!((y - (center[1] + (160.0 - 180.0) * scale)).abs() < 1e-9);
        assert!((partner.box_pixel.height() - 64.0 * scale).abs() < 1e-9);
    }
}

#[test]
fn a_vehicle_at_the_horizon_may_have_a_slightly_negative_disparity() {
    let partner = partner_in(&moved(0.0), &moved(-0.5), detection([300.0, 150.0], 16.0));
    assert!((partner.disparity_px + 0.5).abs() < 0.1);
}

#[test]
fn images_that_are_the_same_or_exchanged_have_no_partners_at_their_own_disparity() {
    // 60 pixels stand for 40 m at a disparity of 1.2 pixels, and for a car at more than 10.
    for (disparity_px, side) in [(0.0, 60.0), (-1.5, 16.0), (-3.0, 60.0), (-17.0, 100.0)] {
        let detection = detection([300.0, 150.0], side);
        let searched = search_in(&moved(0.0), &moved(disparity_px), &[detection]);
        let is_own = |p: &Partner| (p.disparity_px - disparity_px).abs() < 1.0;
        assert!(!searched.partners.iter().any(is_own), "{searched:?}");
    }
}

#[test]
fn a_disparity_that_no_vehicle_of_this_size_has_is_not_looked_at() {
    let left = moved(0.0);
    // 60 pixels at a disparity of 150 are 0.32 m: a toy. At -40 they would be behind infinity.
    for disparity_px in [150.0, -40.0] {
        let right = moved(disparity_px);
        let searched = search_in(&left, &right, &[detection([300.0, 150.0], 60.0)]);
        for partner in searched.partners {
            // 0.5 to 40 m long, with a slack of 1 pixel below and 3 + 0.15 x 60 above.
            assert!((1.2 - 1.0..=96.0 + 12.0).contains(&partner.disparity_px));
            assert!(partner.correlation < 0.8, "something else, by chance");
        }
    }
}

#[test]
fn a_patch_without_texture_has_no_partner() {
    let grey = image(|_, _| 120.0);
    assert_refused(&grey, &grey, detection([300.0, 150.0], 50.0), "both plain");
    assert_refused(
        &moved(0.0),
        &grey,
        detection([300.0, 150.0], 50.0),
        "plain right image",
    );
    assert_refused(
        &grey,
        &moved(0.0),
        detection([300.0, 150.0], 50.0),
        "plain left image",
    );
}

#[test]
fn a_partner_that_something_else_hides_is_not_found() {
    let left = moved(0.0);
    for side in [40.0, 70.0, 150.0] {
        let hidden = image(|x, y| 128.0 + 250.0 * texture(2, x, y));
        assert_refused(
            &left,
            &hidden,
            detection([300.0, 150.0], side),
            "another texture",
        );
    }
}

#[test]
fn a_pattern_that_repeats_itself_has_no_partner() {
    for period in [6.0, 10.0, 16.0] {
        let stripes = |shift: f64| {
            image(move |x, _| {
                128.0 + 80.0 * libm::sin(2.0 * std::f64::consts::PI * (x + shift) / period)
            })
        };
        for side in [40.0, 70.0] {
            assert_refused(
                &stripes(0.0),
                &stripes(3.3),
                detection([300.0, 150.0], side),
                "stripes",
            );
        }
    }
}

#[test]
fn a_vehicle_that_the_right_image_shows_in_part_is_found_and_its_box_clipped() {
    let (left, right) = (moved(0.0), moved(20.0));
    let partner = partner_in(&left, &right, detection([35.0, 150.0], 60.0));
    assert!((partner.disparity_px - 20.0).abs() < 0.1);
    assert_eq!(partner.box_pixel.x_min, 0.0);
    assert!((partner.box_pixel.x_max - 45.0).abs() < 0.1);
    // At the other border the left image shows only a part: it is that part that is found.
    let partner = partner_in(&left, &right, detection([630.0, 350.0], 60.0));
    assert!((partner.disparity_px - 20.0).abs() < 0.1);
    let right_of_it = moved(60.0);
    assert_refused(
        &left,
        &right_of_it,
        detection([32.0, 150.0], 60.0),
        "seen on the left alone",
    );
}

#[test]
fn boxes_that_are_none_have_no_partner() {
    let (left, right) = (moved(0.0), moved(5.0));
    let nan = f64::NAN;
    let infinite = f64::INFINITY;
    for (x_min, y_min, x_max, y_max) in [
        (nan, 10.0, 60.0, 60.0),
        (10.0, 10.0, nan, nan),
        (10.0, 10.0, infinite, 60.0),
        (-infinite, -infinite, infinite, infinite),
        (50.0, 50.0, 50.0, 90.0),
        (90.0, 50.0, 50.0, 90.0),
        (-90.0, -50.0, -50.0, -20.0),
        (900.0, 50.0, 950.0, 90.0),
        (1e300, 1e300, 1.1e300, 1.1e300),
    ] {
        let none = Detection {
            box_pixel: PixelBox::new(x_min, y_min, x_max, y_max),
            ..detection([0.0, 0.0], 1.0)
        };
        assert_refused(&left, &right, none, "no box");
    }
    // Boxes that are odd, but boxes: whatever is found, nothing breaks.
    for odd in [
        PixelBox::new(-1e9, -1e9, 1e9, 1e9),
        PixelBox::new(0.0, 0.0, 640.0, 360.0),
        PixelBox::new(0.0, 100.0, 640.0, 100.5),
        PixelBox::new(300.0, -5.0, 300.2, 900.0),
        PixelBox::new(639.9, 359.9, 700.0, 400.0),
        PixelBox::new(0.0, 0.0, 1e-9, 1e-9),
    ] {
        let odd = Detection {
            box_pixel: odd,
            ..detection([0.0, 0.0], 1.0)
        };
        let searched = search_in(&left, &right, &[odd]);
        assert_eq!(searched.partners.len() + searched.left_only.len(), 1);
    }
}

#[test]
fn images_of_a_few_pixels_and_rigs_that_nobody_builds_break_nothing() {
    let config = PairingConfig::default();
    for (width, height) in [(2, 2), (3, 40), (40, 3), (13, 13)] {
        let tiny = RgbImage::from_fn(width, height, |x, y| {
            image::Rgb([(x * 37 + y * 91) as u8; 3])
        });
        let rig = StereoRig::from_hfov(width, height, 90.0, 0.8).unwrap();
        let whole = detection([f64::from(width) / 2.0, f64::from(height) / 2.0], 40.0);
        let searched = search([&tiny, &tiny], &[whole], &rig, &config);
        assert_eq!(searched.partners.len() + searched.left_only.len(), 1);
    }
    let (left, right) = (moved(0.0), moved(5.0));
    for (focal_px, baseline_m) in [(1e-12, 0.8), (1e12, 0.8), (320.0, 1e12), (1e300, 1e300)] {
        let mut rig = rig();
        rig.right.focal_x_px = focal_px;
        rig.baseline_m = baseline_m;
        let searched = search(
            [&left, &right],
            &[detection([300.0, 150.0], 50.0)],
            &rig,
            &config,
        );
        assert_eq!(searched.partners.len() + searched.left_only.len(), 1);
    }
}

#[test]
fn no_detections_have_no_partners() {
    let any = moved(0.0);
    assert_eq!(search_in(&any, &any, &[]), Searched::default());
}

#[test]
fn two_detections_never_share_a_partner() {
    // Two vehicles that look the same, 60 pixels apart; the right image shows one of them.
    let vehicle = |x: f64, y: f64, at: f64| {
        let inside = (x - at).abs() < 20.0 && (y - 150.0).abs() < 20.0;
        inside.then(|| 128.0 + 250.0 * texture(1, x - at, y))
    };
    let street = |x: f64, y: f64| 100.0 + 40.0 * texture(3, x, y);
    let left = image(|x, y| {
        vehicle(x, y, 300.0)
            .or_else(|| vehicle(x, y, 345.0))
            .unwrap_or_else(|| street(x, y))
    });
    let right = image(|x, y| vehicle(x, y, 290.0).unwrap_or_else(|| street(x + 2.0, y)));
    let both = [
        detection([345.5, 150.0], 40.0),
        detection([300.0, 150.0], 40.0),
    ];
    for (first, second) in [(0, 1), (1, 0)] {
        let searched = search_in(&left, &right, &[both[first], both[second]]);
        assert_eq!(searched.partners.len(), 1, "{searched:?}");
        assert_eq!(searched.left_only.len(), 1);
    }
}

#[test]
fn hundreds_of_vehicles_keep_their_order_on_any_number_of_threads() {
    let (left, right) = (moved(0.0), moved(7.3));
    let mut many: Vec<Detection> = (0..300u32)
        .map(|i| {
            let center = [
                20.0 + 30.0 * f64::from(i % 20),
                20.0 + 22.0 * f64::from(i / 20),
            ];
            detection(center, 18.0 + f64::from(i % 7))
        })
        .collect();
    many[100].box_pixel.x_min = f64::NAN;
    let searched = search_in(&left, &right, &many);
    assert!(searched.partners.len() > 280, "{}", searched.partners.len());
    assert!(searched.left_only.contains(&100));
    let mut indices: Vec<usize> = searched.partners.iter().map(|p| p.left).collect();
    assert!(indices.is_sorted() && searched.left_only.is_sorted());
    indices.extend(&searched.left_only);
    indices.sort_unstable();
    assert_eq!(indices, (0..300).collect::<Vec<_>>());
    let right_ones = searched.partners.iter();
    let off = right_ones
        .filter(|p| (p.disparity_px - 7.3).abs() > 0.1)
        .count();
    assert_eq!(off, 0);

    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(pool.install(|| search_in(&left, &right, &many)), searched);
}
