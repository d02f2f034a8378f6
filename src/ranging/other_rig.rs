//! A network at work behind other cameras than those it was trained with.
//!
//! Its box-size input stands for angles: a car of the same width at the same distance fills the same
//! angle whatever the focal length, but another part of the image. [`sizes_as_trained`] says which
//! part of the trained cameras' images the same angle would have filled. What cannot be converted,
//! [`RigNote`] names.

use std::fmt;

use super::Readout;
use crate::geometry::{Camera, PixelBox, StereoRig};

/// Cameras and baselines that differ by less are the same, relative.
const SAME: f64 = 0.01;

/// The geometry vector (`norm_w`, `norm_h`) that the boxes of a vehicle, as large as `rig` shows it,
/// would have had with the trained rig: the mean of both boxes' angular sizes, in parts of the trained
/// image.
pub fn sizes_as_trained(boxes: [&PixelBox; 2], rig: &StereoRig, trained: &StereoRig) -> [f32; 2] {
    let [left, right] = boxes;
    let sides = [
        (left, &rig.left, &trained.left),
        (right, &rig.right, &trained.right),
    ];
    let [(width_l, height_l), (width_r, height_r)] = sides.map(|(area, camera, trained)| {
        (
            area.width() * (trained.focal_x_px / camera.focal_x_px),
            area.height() * (trained.focal_y_px / camera.focal_y_px),
        )
    });
    [
        (f64::midpoint(width_l, width_r) / f64::from(trained.left.width)) as f32,
        (f64::midpoint(height_l, height_r) / f64::from(trained.left.height)) as f32,
    ]
}

/// In what images differ from those that a run was trained on, and what is done about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RigNote {
    /// The images are larger or smaller than the calibrated ones, of the same shape.
    Resized {
        /// The calibrated size, pixels.
        calibrated: [u32; 2],
        /// Theirs.
        images: [u32; 2],
    },
    /// Nobody said which cameras took the images, and their size is not the trained one; the shape
    /// is.
    Assumed {
        /// The trained size, pixels.
        trained: [u32; 2],
        /// Theirs.
        images: [u32; 2],
    },
    /// The same, and the shape is another one too.
    Unknown {
        /// The trained size, pixels.
        trained: [u32; 2],
        /// Theirs.
        images: [u32; 2],
    },
    /// Cameras of another field of view.
    FieldOfView {
        /// The trained horizontal field of view, radians.
        trained: f64,
        /// Theirs.
        images: f64,
        /// How much larger a vehicle at the same distance is in the images, in parts of their width.
        enlarged: f64,
        /// What the network's output stands for.
        readout: Readout,
    },
    /// Cameras at another distance from each other.
    Baseline {
        /// The trained one, metres.
        trained_m: f64,
        /// Theirs.
        images_m: f64,
        /// Their focal length times baseline in parts of the image width, over the trained one: how
        /// much larger disparities are.
        disparity: f64,
    },
}

impl RigNote {
    /// What there is to say of images of this rig, given by a calibration.
    pub fn of_rig(trained: &StereoRig, rig: &StereoRig, readout: Readout) -> Vec<Self> {
        let mut notes = Vec::new();
        let per_width = |rig: &StereoRig| rig.focal_px() / f64::from(rig.left.width);
        let enlarged = per_width(rig) / per_width(trained);
        if (enlarged - 1.0).abs() > SAME {
            notes.push(Self::FieldOfView {
                trained: field_of_view(&trained.left),
                images: field_of_view(&rig.left),
                enlarged,
                readout,
            });
        }
        let apart = rig.baseline_m / trained.baseline_m;
        if (apart - 1.0).abs() > SAME {
            notes.push(Self::Baseline {
                trained_m: trained.baseline_m,
                images_m: rig.baseline_m,
                disparity: apart * enlarged,
            });
        }
        notes
    }

    /// What there is to say of images of this size that come without calibration.
    pub fn of_size(trained: &StereoRig, images: [u32; 2]) -> Option<Self> {
        let own = [trained.left.width, trained.left.height];
        if own == images {
            return None;
        }
        Some(if crate::geometry::is_same_shape(own, images) {
            Self::Assumed {
                trained: own,
                images,
            }
        } else {
            Self::Unknown {
                trained: own,
                images,
            }
        })
    }
}

/// Horizontal field of view, radians.
fn field_of_view(camera: &Camera) -> f64 {
    let [left, _, _] = camera.camera_from_pixel([0.0, 0.0]);
    let [right, _, _] = camera.camera_from_pixel([f64::from(camera.width), 0.0]);
    libm::atan(right) - libm::atan(left)
}

impl fmt::Display for RigNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Resized { calibrated, images } => write!(
                f,
                "the images have {}x{} pixels and the calibration is of {}x{}: they are taken for \
                 the calibrated ones resized, not cut",
                images[0], images[1], calibrated[0], calibrated[1]
            ),
            Self::Assumed { trained, images } => write!(
                f,
                "the images have {}x{} pixels and the run was trained on {}x{}: they are taken for \
                 images of the trained cameras, resized; if other cameras took them, give --calib",
                images[0], images[1], trained[0], trained[1]
            ),
            Self::Unknown { trained, images } => write!(
                f,
                "the images have {}x{} pixels and the run was trained on {}x{}, another shape: the \
                 trained horizontal field of view and baseline are assumed, and distances are off \
                 where that is wrong; give --calib",
                images[0], images[1], trained[0], trained[1]
            ),
            Self::FieldOfView {
                trained,
                images,
                enlarged,
                readout,
            } => {
                write!(
                    f,
                    "the cameras see {:.1} degrees and the run was trained with {:.1}: a vehicle is \
                     {enlarged:.2} times as large in the image. Box sizes are rescaled by that for \
                     the distance network{}; detector and crops see vehicles as sharp as at {:.2} \
                     times their distance in training",
                    images.to_degrees(),
                    trained.to_degrees(),
                    match readout {
                        Readout::Size =>
                            ", and its metres of vehicle become metres of distance by these cameras",
                        Readout::Surface => ", and surfaces are triangulated by these cameras",
                        Readout::Distance => "",
                    },
                    1.0 / enlarged
                )
            }
            Self::Baseline {
                trained_m,
                images_m,
                disparity,
            } => write!(
                f,
                "the cameras stand {images_m:.3} m apart and the run was trained with {trained_m:.3}: \
                 disparities are {disparity:.2} times as large in parts of the image. Pairing goes by \
                 these cameras; the two crops differ more or less than in training"
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rig(width: u32, hfov_deg: f64, baseline_m: f64) -> StereoRig {
        StereoRig::from_hfov(width, width * 9 / 16, hfov_deg, baseline_m).unwrap()
    }

    /// Boxes of a square of 4 m around a point.
    fn boxes(rig: &StereoRig, point: [f64; 3]) -> [PixelBox; 2] {
        let centers = rig.pixels_from_rig(point).unwrap();
        [(centers[0], rig.left), (centers[1], rig.right)].map(|(center, camera)| {
            let side = 4.0 * camera.focal_x_px / point[2];
            PixelBox::from_center(center, side, side)
        })
    }

    #[test]
    fn the_same_vehicle_has_the_same_size_whatever_the_focal_length_and_resolution() {
        let trained = rig(640, 90.0, 0.8);
        let at = |rig: &StereoRig| {
            let [left, right] = boxes(rig, [2.0, 1.0, 22.0]);
            sizes_as_trained([&left, &right], rig, &trained)
        };
        let expected = [4.0 * 320.0 / 22.0 / 640.0, 4.0 * 320.0 / 22.0 / 360.0];
        for other in [
            trained,
            rig(640, 45.0, 0.8),
            rig(1280, 60.0, 0.2),
            rig(2048, 110.0, 1.5),
        ] {
            let found = at(&other);
            for axis in 0..2 {
                assert!((f64::from(found[axis]) - expected[axis]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn with_the_trained_rig_the_sizes_are_those_of_training_to_the_bit() {
        let trained = rig(640, 90.0, 0.8);
        let [left, right] = boxes(&trained, [-3.0, 2.0, 17.3]);
        assert_eq!(
            sizes_as_trained([&left, &right], &trained, &trained),
            crate::dataset::geometry_vector(&left, &right, 640, 360)
        );
    }

    #[test]
    fn notes_are_made_of_what_differs_and_of_nothing_else() {
        let trained = rig(640, 90.0, 0.8);
        let notes = |other: &StereoRig| RigNote::of_rig(&trained, other, Readout::Size);
        assert_eq!(notes(&trained), []);
        assert_eq!(notes(&rig(1280, 90.0, 0.8)), []);
        let [
            RigNote::FieldOfView {
                enlarged, images, ..
            },
        ] = notes(&rig(640, 53.130_102_354_155_98, 0.8))[..]
        else {
            panic!("one note");
        };
        assert!((enlarged - 2.0).abs() < 1e-9 && (images.to_degrees() - 53.13).abs() < 0.01);
        let [RigNote::Baseline { disparity, .. }] = notes(&rig(640, 90.0, 0.2))[..] else {
            panic!("one note");
        };
        assert_eq!(disparity, 0.25);
        assert_eq!(notes(&rig(640, 60.0, 0.2)).len(), 2);
        assert_eq!(RigNote::of_size(&trained, [640, 360]), None);
        assert!(matches!(
            RigNote::of_size(&trained, [1280, 720]),
            Some(RigNote::Assumed { .. })
        ));
        assert!(matches!(
            RigNote::of_size(&trained, [1242, 375]),
            Some(RigNote::Unknown { .. })
        ));
    }

    #[test]
    fn every_note_names_both_rigs_and_what_is_done() {
        let trained = rig(640, 90.0, 0.8);
        let mut notes = RigNote::of_rig(&trained, &rig(1024, 60.0, 0.12), Readout::Size);
        notes.extend(RigNote::of_size(&trained, [1280, 720]));
        notes.extend(RigNote::of_size(&trained, [1242, 375]));
        notes.push(RigNote::Resized {
            calibrated: [1280, 720],
            images: [640, 360],
        });
        let words = [
            ["60.0", "90.0", "rescaled"],
            ["0.120", "0.800", "Pairing"],
            ["1280x720", "640x360", "--calib"],
            ["1242x375", "640x360", "assumed"],
            ["1280x720", "640x360", "resized"],
        ];
        assert_eq!(notes.len(), words.len());
        for (note, words) in notes.iter().zip(words) {
            for word in words {
                assert!(note.to_string().contains(word), "{note}: {word}");
            }
        }
    }
}
