use burn::module::Param;
use burn::tensor::{Device, Distribution, Tensor, TensorData};
use image::{Rgb, RgbImage};

use super::*;
use crate::dataset::{BoxKind, composite_into_planes};
use crate::ranging::{RangingNetwork, ranging_loss};

const SIZE: CompositeSize = CompositeSize::SMALLEST;

const SIZES: VehicleSizes = VehicleSizes {
    least_m: 2.0,
    typical_m: 4.0,
    largest_m: 6.0,
};

fn rig() -> StereoRig {
    StereoRig::from_hfov(320, 180, 90.0, 0.8).unwrap()
}

fn header(crops: Crops, readout: Readout, sizes: Option<VehicleSizes>) -> RangingHeader {
    RangingHeader {
        network: RangingHeader::NETWORK.to_owned(),
        version: "1".to_owned(),
        composite: SIZE,
        readout,
        crops,
        sizes,
        normalization: ChannelStatistics {
            mean: [0.4, 0.5, 0.6],
            std: [0.1, 0.2, 0.3],
        },
        box_kind: BoxKind::Sphere,
        classes: vec!["car".to_owned()],
        rig: rig(),
    }
}

/// A texture without repetition, moved to the left.
fn texture(shift: u32) -> RgbImage {
    RgbImage::from_fn(320, 180, |x, y| {
        let mut bits = (x + shift)
            .wrapping_mul(0x9E37_79B9)
            .wrapping_add(y.wrapping_mul(0x85EB_CA6B));
        bits ^= bits >> 15;
        bits = bits.wrapping_mul(0x2C1B_3C6D);
        bits ^= bits >> 12;
        Rgb([bits as u8, (bits >> 8) as u8, (bits >> 16) as u8])
    })
}

/// Boxes of a vehicle of this size at a disparity, around the middle of the left image.
fn boxes(size_m: f64, disparity_px: f64) -> [PixelBox; 2] {
    let side = size_m * disparity_px / 0.8;
    let left = PixelBox::from_center([160.0, 90.0], side, side);
    let right = PixelBox::from_center([160.0 - disparity_px, 90.0], side, side);
    [left, right]
}

fn planes(header: &RangingHeader, sighting: &Sighting) -> Vec<f32> {
    let mut planes = vec![f32::NAN; SIZE.plane_values()];
    header.compose(sighting, &mut planes);
    planes
}

#[test]
fn the_papers_composite_is_the_default_one() {
    let images = [texture(0), texture(8)];
    let sighting = Sighting {
        images: [&images[0], &images[1]],
        boxes: boxes(4.0, 8.0),
    };
    let header = header(Crops::default(), Readout::Distance, None);
    let mut expected = vec![0.0; SIZE.plane_values()];
    let [left, right] = &sighting.boxes;
    composite_into_planes(
        sighting.images,
        [left, right],
        SIZE,
        &header.normalization,
        &mut expected,
    );
    assert_eq!(planes(&header, &sighting), expected);
    assert_eq!(header.geometry_numbers(), 2);
}

#[test]
fn one_image_is_all_that_mono_and_right_right_know_of() {
    let images = [texture(0), texture(8), texture(55)];
    let [left, right] = boxes(4.0, 8.0);
    let other = PixelBox::new(3.0, 4.0, 90.0, 170.0);
    for crops in [Crops::Mono, Crops::RightRight] {
        let header = header(crops, Readout::Size, None);
        let [one, another] = [(0, left), (2, other)].map(|(image, left)| Sighting {
            images: [&images[image], &images[1]],
            boxes: [left, right],
        });
        assert_eq!(planes(&header, &one), planes(&header, &another));
        assert_eq!(
            header.reading(&one, &rig()),
            header.reading(&another, &rig())
        );
    }
}

#[test]
fn mono_shows_the_right_crop_once_and_right_right_twice() {
    let images = [texture(0), texture(8)];
    let sighting = Sighting {
        images: [&images[0], &images[1]],
        boxes: boxes(4.0, 8.0),
    };
    let of = |crops| planes(&header(crops, Readout::Distance, None), &sighting);
    let [both, twice, once] = [Crops::RightLeft, Crops::RightRight, Crops::Mono].map(of);
    let half = SIZE.width as usize * SIZE.width as usize;
    for channel in 0..3 {
        let rows =
            |planes: &[f32], part: usize| planes[(2 * channel + part) * half..][..half].to_vec();
        let right = rows(&both, 0);
        assert_eq!((&rows(&twice, 0), &rows(&twice, 1)), (&right, &right));
        assert_eq!(rows(&once, 0), right);
        assert!(rows(&once, 1).iter().all(|value| *value == 0.0));
    }
}

#[test]
fn a_found_surface_is_where_the_disparity_says_whatever_the_readout() {
    let images = [texture(0), texture(16)];
    let sighting = Sighting {
        images: [&images[0], &images[1]],
        boxes: boxes(4.0, 16.0),
    };
    // In the middle of the left image; the midpoint between the cameras is 0.4 m beside it.
    let depth_m = 160.0 * 0.8 / 16.0;
    let distance_m = (depth_m * depth_m + 0.16_f64).sqrt();
    for readout in [Readout::Distance, Readout::Size, Readout::Surface] {
        let header = header(Crops::RightLeft, readout, Some(SIZES));
        let reading = header.reading(&sighting, &rig());
        let [_, _, found, tens_of_m, size_m] = reading.geometry[..] else {
            panic!("{reading:?}");
        };
        assert_eq!((found, header.geometry_numbers()), (1.0, 5));
        assert!((f64::from(tens_of_m) * 10.0 - distance_m).abs() < 0.02);
        assert!((size_m - 4.0).abs() < 0.02, "{size_m}");
        let expected_m = if readout == Readout::Surface {
            distance_m
        } else {
            0.0
        };
        assert!((reading.distance_m(0.0) - expected_m).abs() < 0.02);
    }
}

#[test]
fn where_nothing_is_found_the_typical_size_stands_in_and_a_flag_says_so() {
    let plain = RgbImage::from_pixel(320, 180, Rgb([90; 3]));
    let images = [texture(0), texture(16)];
    // Nothing to compare; and a vehicle of 9 m where none is larger than 6 m.
    for (images, boxes) in [
        ([&plain, &plain], boxes(4.0, 16.0)),
        ([&images[0], &images[1]], boxes(9.0, 16.0)),
    ] {
        let sighting = Sighting { images, boxes };
        let header = header(Crops::RightLeft, Readout::Surface, Some(SIZES));
        let reading = header.reading(&sighting, &rig());
        let [left, right] = &sighting.boxes;
        let per_size = Readout::Size.distance_per_output([left, right], &rig());
        assert_eq!(reading.geometry[2], 0.0);
        assert!((f64::from(reading.geometry[4]) - 4.0).abs() < 1e-5);
        assert!((reading.distance_m(0.0) - 4.0 * per_size).abs() < 1e-9);
    }
}

#[test]
fn sizes_are_those_of_the_labels_and_what_is_no_size_is_none() {
    let sizes = VehicleSizes::of([5.0, f64::NAN, 3.0, -1.0, 4.0].into_iter()).unwrap();
    assert_eq!(
        (sizes.least_m, sizes.typical_m, sizes.largest_m),
        (3.0, 4.0, 5.0)
    );
    assert_eq!(VehicleSizes::of([f64::NAN].into_iter()), None);
}

#[test]
fn a_header_that_does_not_say_what_was_shown_means_both_crops_and_no_disparity() {
    let mut old = serde_json::to_value(header(Crops::Mono, Readout::Size, Some(SIZES))).unwrap();
    let fields = old.as_object_mut().unwrap();
    fields.remove("crops").unwrap();
    fields.remove("sizes").unwrap();
    let read: RangingHeader = serde_json::from_value(old).unwrap();
    assert_eq!((read.crops, read.sizes), (Crops::RightLeft, None));
}

#[test]
fn the_losss_gradient_reaches_every_number_of_the_geometry_vector() {
    let device = Device::flex().autodiff();
    device.seed(5);
    let header = header(Crops::RightLeft, Readout::Surface, Some(SIZES));
    let network = header.config().init(&device).unwrap();
    let column = |values: [f32; 2]| {
        Tensor::<2>::from_data(TensorData::new(values.to_vec(), [2, 1]), &device)
    };
    let features = Tensor::random([2, 64], Distribution::Normal(0.0, 1.0), &device);
    let geometry = [0.1, 0.1, 1.0, 2.0, 4.0, 0.2, 0.2, 0.0, 1.0, 3.0];
    let geometry = Tensor::<2>::from_data(TensorData::new(geometry.to_vec(), [2, 5]), &device);
    let loss = |network: &RangingNetwork| {
        let output = network.readout(features.clone(), geometry.clone());
        let distances_m = output + column([20.0, 10.0]);
        ranging_loss(distances_m, column([20.5, 11.0])).total
    };
    let gradients = loss(&network).backward();
    let gradient = network.out.weight.val().grad(&gradients).unwrap();
    let gradient: Vec<f32> = gradient.try_into_vec_as().unwrap();
    let weights: Vec<f32> = network.out.weight.val().try_into_vec_as().unwrap();
    for place in 64..69 {
        let moved = |by: f32| -> f64 {
            let mut weights = weights.clone();
            weights[place] += by;
            let shape = network.out.weight.val().dims();
            let mut moved = network.clone();
            moved.out.weight =
                Param::from_tensor(Tensor::from_data(TensorData::new(weights, shape), &device));
            loss(&moved).into_scalar::<f64>()
        };
        let step = 0.02;
        // The loss is a square, of which central differences are exact but for rounding.
        let difference = (moved(step) - moved(-step)) / f64::from(2.0 * step);
        let gradient = f64::from(gradient[place]);
        assert!(
            (difference - gradient).abs() < 0.01 * gradient.abs().max(1.0),
            "{place}: {difference} {gradient}"
        );
    }
}
