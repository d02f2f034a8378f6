//! Arithmetic that a network must beat: distances from box size, box centres and sub-pixel
//! disparity.
//!
//! * **size**: `distance = c / norm_w`, with `norm_w` the mean width of the two boxes over the image
//!   width. The constant is kept as a length, `c = size_m * focal_px / image_width_px`, and so holds
//!   for other cameras.
//! * **triangulation**: the disparity of the two boxes' centres, and nothing fitted. Of labelled
//!   `sphere` boxes, whose centres are projections of the true centre, this is arithmetic on the
//!   label and no measurement; of boxes that were searched for it is the search's disparity.
//! * **matching**: the disparity that normalised cross-correlation of the left box's pixels finds
//!   along the epipolar line. It is the visible surface's; the fitted constant is the way from there
//!   to the vehicle's centre.
//!
//! Constants come from the training split alone.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::training_data::TrainingData;
use super::vehicles::Estimates;
use crate::dataset::{BoxKind, Frame, Split, StereoDataset};
use crate::error::Result;
use crate::geometry::{PixelBox, StereoRig};
use crate::progress::{Progress, in_parallel};
use crate::ranging::{Sighting, surface_m};

/// Frames whose images are matched for the constants: two numbers need no more.
const FITTED_FRAMES: usize = 160;

/// Nothing is farther than this many times the farthest vehicle of the training split: a disparity
/// of nearly nothing would otherwise count as kilometres.
const FARTHEST: f64 = 2.0;

/// The baselines' constants, and where they come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Baselines {
    /// Dataset whose training split they were fitted on.
    pub fitted_on: PathBuf,
    /// Vehicles of that split, for the size.
    pub vehicles: usize,
    /// Vehicles that matching had an answer for, for the other constants.
    pub matched: usize,
    /// Effective width of a vehicle's box, metres: the median of `distance * width / focal length`.
    pub size_m: f64,
    /// The same as the constant of `distance = c / norm_w`, for the rig it was fitted on.
    pub size_constant_m: f64,
    /// From the surface that matching sees to the vehicle's centre, metres: the median difference.
    pub surface_to_center_m: f64,
    /// Answers beyond this are set to it, metres.
    pub farthest_m: f64,
}

impl Baselines {
    /// Fits the constants on the training split of a dataset; None where it has no stereo vehicles
    /// to fit on.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`]. Images that cannot be read are left out.
    pub fn fit(
        dataset: &StereoDataset,
        kind: BoxKind,
        progress: &dyn Progress,
    ) -> Result<Option<Self>> {
        if !dataset.info.stereo {
            return Ok(None);
        }
        let frames = dataset.split(Split::Train);
        let rig = dataset.rig();
        let of_labels: Vec<(f64, f64)> = frames
            .iter()
            .flat_map(|frame| frame.vehicles(kind))
            .map(|vehicle| {
                let boxes = [vehicle.left.box_pixel, vehicle.right.box_pixel];
                (
                    vehicle.distance_m,
                    vehicle.distance_m * width_m(&boxes, rig),
                )
            })
            .filter(|(_, size_m)| size_m.is_finite() && *size_m > 0.0)
            .collect();
        let Some(size_m) = median(of_labels.iter().map(|(_, size_m)| *size_m)) else {
            return Ok(None);
        };
        let farthest_m = FARTHEST
            * of_labels
                .iter()
                .map(|(true_m, _)| *true_m)
                .fold(0.0, f64::max);
        let behind_m = measure(dataset, &frames, kind, progress)?;
        let surface_to_center_m = median(behind_m.iter().copied()).unwrap_or(0.0);
        Ok(Some(Self {
            fitted_on: dataset.folder.clone(),
            vehicles: of_labels.len(),
            matched: behind_m.len(),
            size_m,
            size_constant_m: size_m * rig.focal_px() / f64::from(rig.left.width),
            surface_to_center_m,
            farthest_m,
        }))
    }

    /// What every baseline says of a vehicle; the estimates of the rangers are left empty.
    pub fn estimates(&self, sighting: &Sighting, rig: &StereoRig) -> Estimates {
        let within = |estimate: f64| estimate.min(self.farthest_m);
        let width_m = width_m(&sighting.boxes, rig);
        let size = (width_m > 0.0).then(|| within(self.size_m / width_m));
        let triangulation = centers_m(&sighting.boxes, rig).map(within);
        let matching =
            surface_m(sighting, rig).map(|surface_m| within(surface_m + self.surface_to_center_m));
        [None, None, size, triangulation, matching]
    }
}

/// Fits the baselines on the dataset that a run was trained on, as it divided it; on the evaluated
/// one where that cannot be had.
///
/// # Errors
/// [`crate::Error::Interrupted`].
pub(super) fn fit_for_run(
    run: Option<&Path>,
    evaluated: &StereoDataset,
    kind: BoxKind,
    progress: &dyn Progress,
) -> Result<Option<Baselines>> {
    let Some(run) = run else {
        return Baselines::fit(evaluated, kind, progress);
    };
    let why = match TrainingData::find(run, evaluated) {
        TrainingData::Evaluated => return Baselines::fit(evaluated, kind, progress),
        TrainingData::Other(dataset) => {
            let folder = dataset.folder.display();
            if let Some(baselines) = Baselines::fit(&dataset, kind, progress)? {
                progress.note(&format!(
                    "the baselines are fitted on the training split of {folder}, which the run was \
                     trained on"
                ));
                return Ok(Some(baselines));
            }
            format!("{folder}, which the run was trained on, has nothing to fit the baselines on")
        }
        TrainingData::Lost(path) => format!(
            "the dataset that the run was trained on ({}) is not where it was, or has changed",
            path.display()
        ),
        TrainingData::Unknown => "the run does not say which dataset it was trained on".to_owned(),
    };
    let fitted = Baselines::fit(evaluated, kind, progress)?;
    progress.note(&if fitted.is_some() {
        format!(
            "{why}: the baselines are fitted on the training split of {}, which favours them",
            evaluated.folder.display()
        )
    } else {
        "there is no training split to fit the baselines on: they are left out".to_owned()
    });
    Ok(fitted)
}

/// How far the centres of the vehicles of evenly chosen frames lie behind the surface that matching
/// sees, metres, where it sees one.
fn measure(
    dataset: &StereoDataset,
    frames: &[&Frame],
    kind: BoxKind,
    progress: &dyn Progress,
) -> Result<Vec<f64>> {
    let rig = dataset.rig();
    let count = frames.len().min(FITTED_FRAMES);
    let chosen: Vec<&Frame> = (0..count)
        .map(|i| frames[(2 * i + 1) * frames.len() / (2 * count)])
        .collect();
    let resume = "run the command again";
    let samples = in_parallel(progress, "fitting baselines", resume, &chosen, |frame| {
        let Ok([left, right]) = frame.load(rig) else {
            return Ok(Vec::new());
        };
        let vehicles = frame.vehicles(kind);
        Ok(vehicles
            .par_iter()
            .filter_map(|vehicle| {
                let sighting = Sighting {
                    images: [&left, &right],
                    boxes: [vehicle.left.box_pixel, vehicle.right.box_pixel],
                };
                Some(vehicle.distance_m - surface_m(&sighting, rig)?)
            })
            .collect::<Vec<_>>())
    })?;
    Ok(samples.into_iter().flatten().collect())
}

/// Mean width of two boxes at a distance of one metre, metres.
fn width_m([left, right]: &[PixelBox; 2], rig: &StereoRig) -> f64 {
    f64::midpoint(
        left.width() / rig.left.focal_x_px,
        right.width() / rig.right.focal_x_px,
    )
}

/// Distance of the point that both boxes' centres show, metres.
fn centers_m([left, right]: &[PixelBox; 2], rig: &StereoRig) -> Option<f64> {
    let disparity_px = rig.disparity_of_pixels(left.center()[0], right.center()[0]);
    rig.triangulated_m(left.center(), disparity_px)
}

/// The middle value; of two the upper one.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixture::Fixture;
    use crate::progress::Silent;
    use image::RgbImage;

    #[test]
    fn the_size_of_vehicles_of_one_size_gives_their_distance_and_centres_triangulate_it() {
        let fixture = Fixture::lawful(20);
        let dataset = fixture.open();
        let rig = *dataset.rig();
        let baselines = Baselines::fit(&dataset, BoxKind::Sphere, &Silent)
            .unwrap()
            .unwrap();
        assert_eq!(baselines.vehicles, 20);
        let black = RgbImage::new(rig.left.width, rig.left.height);
        for vehicle in dataset.frames[9].vehicles(BoxKind::Sphere) {
            let sighting = Sighting {
                images: [&black, &black],
                boxes: [vehicle.left.box_pixel, vehicle.right.box_pixel],
            };
            let [fused, network, size, triangulation, matching] =
                baselines.estimates(&sighting, &rig);
            assert_eq!((fused, network, matching), (None, None, None));
            // Boxes are as wide as the depth says, not the distance.
            let size = size.unwrap();
            assert!((size / vehicle.distance_m - 1.0).abs() < 0.1, "{size}");
            let triangulation = triangulation.unwrap();
            assert!(
                (triangulation - vehicle.distance_m).abs() < 0.01,
                "{triangulation}"
            );
        }
    }

    #[test]
    fn a_dataset_without_a_training_split_has_no_baselines() {
        let fixture = Fixture::lawful(5);
        let text = std::fs::read_to_string(fixture.path("frames.csv")).unwrap();
        fixture.write("frames.csv", &text.replace(",train,", ",test,"));
        let fitted = Baselines::fit(&fixture.open(), BoxKind::Sphere, &Silent).unwrap();
        assert_eq!(fitted, None);
    }
}
