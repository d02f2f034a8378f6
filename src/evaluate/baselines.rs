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
//! * **fusion**: a constant and a share of each of size and matching; size where matching has no
//!   answer.
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

/// Rounds of reweighting of the fusion's fit; it moves no more after half of them.
const ROUNDS: usize = 30;

/// Relative errors above this count less and less in the fusion's fit.
const USUAL_ERROR: f64 = 0.1;

/// The fusion where nothing can be fitted, and where its fit starts from.
const EVEN_FUSION: [f64; 3] = [0.0, 0.5, 0.5];

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
    /// Of the fusion: constant in metres, share of size, share of matching.
    pub fusion: [f64; 3],
    /// Answers beyond this are set to it, metres.
    pub farthest_m: f64,
}

/// A training vehicle: the truth, what its size says, and how far matching sees its surface; metres.
type Sample = (f64, f64, Option<f64>);

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
        let samples = measure(dataset, &frames, kind, size_m, progress)?;
        let matched: Vec<(f64, f64, f64)> = samples
            .iter()
            .filter_map(|&(true_m, size_m, surface_m)| Some((true_m, size_m, surface_m?)))
            .collect();
        let offset = median(
            matched
                .iter()
                .map(|(true_m, _, surface_m)| true_m - surface_m),
        );
        let surface_to_center_m = offset.unwrap_or(0.0);
        let rows: Vec<([f64; 3], f64)> = matched
            .iter()
            .map(|&(true_m, size_m, surface_m)| {
                let matching_m = (surface_m + surface_to_center_m).min(farthest_m);
                ([1.0, size_m.min(farthest_m), matching_m], true_m)
            })
            .collect();
        Ok(Some(Self {
            fitted_on: dataset.folder.clone(),
            vehicles: of_labels.len(),
            matched: matched.len(),
            size_m,
            size_constant_m: size_m * rig.focal_px() / f64::from(rig.left.width),
            surface_to_center_m,
            fusion: fit_fusion(&rows).unwrap_or(EVEN_FUSION),
            farthest_m,
        }))
    }

    /// What every baseline says of a vehicle; the first estimate, the network's, is left empty.
    pub fn estimates(&self, sighting: &Sighting, rig: &StereoRig) -> Estimates {
        let within = |estimate: f64| estimate.min(self.farthest_m);
        let width_m = width_m(&sighting.boxes, rig);
        let size = (width_m > 0.0).then(|| within(self.size_m / width_m));
        let triangulation = centers_m(&sighting.boxes, rig).map(within);
        let matching =
            surface_m(sighting, rig).map(|surface_m| within(surface_m + self.surface_to_center_m));
        let [constant, of_size, of_matching] = self.fusion;
        let fusion = match (size, matching) {
            (Some(size), Some(matching)) => {
                Some(constant + of_size * size + of_matching * matching)
            }
            (size, _) => size,
        };
        [None, size, triangulation, matching, fusion]
    }
}

/// Fits the baselines on the dataset that a run was trained on, as it divided it; on the evaluated
/// one where that cannot be had.
///
/// # Errors
/// [`crate::Error::Interrupted`].
pub(super) fn fit_for_run(
    run: &Path,
    evaluated: &StereoDataset,
    kind: BoxKind,
    progress: &dyn Progress,
) -> Result<Option<Baselines>> {
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

/// Matches the vehicles of evenly chosen frames.
fn measure(
    dataset: &StereoDataset,
    frames: &[&Frame],
    kind: BoxKind,
    size_m: f64,
    progress: &dyn Progress,
) -> Result<Vec<Sample>> {
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
            .map(|vehicle| {
                let sighting = Sighting {
                    images: [&left, &right],
                    boxes: [vehicle.left.box_pixel, vehicle.right.box_pixel],
                };
                let by_size_m = size_m / width_m(&sighting.boxes, rig);
                (vehicle.distance_m, by_size_m, surface_m(&sighting, rig))
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

/// Coefficients that fit most vehicles: least squares of relative errors, reweighted until the few
/// that matching takes for something else, whose errors are far above [`USUAL_ERROR`], hardly count
/// (Cauchy's weights). Squares alone would follow those few.
fn fit_fusion(rows: &[([f64; 3], f64)]) -> Option<[f64; 3]> {
    let mut solution = EVEN_FUSION;
    for _ in 0..ROUNDS {
        let mut normal = [[0.0; 4]; 3];
        for (features, truth) in rows {
            let estimate: f64 = features.iter().zip(&solution).map(|(f, c)| f * c).sum();
            let error = (estimate - truth) / truth;
            let weight = truth.powi(-2) / (1.0 + (error / USUAL_ERROR).powi(2));
            for i in 0..3 {
                for j in 0..3 {
                    normal[i][j] += weight * features[i] * features[j];
                }
                normal[i][3] += weight * features[i] * truth;
            }
        }
        solution = solve(normal)?;
    }
    Some(solution)
}

/// Solves three linear equations by elimination; None where they do not determine the unknowns.
fn solve(mut rows: [[f64; 4]; 3]) -> Option<[f64; 3]> {
    for column in 0..3 {
        let pivot =
            (column..3).max_by(|&a, &b| rows[a][column].abs().total_cmp(&rows[b][column].abs()))?;
        rows.swap(column, pivot);
        let lead = rows[column];
        // Relative to the largest number of the row, which the scale of metres does not change.
        let scale = lead
            .iter()
            .fold(0.0_f64, |most, value| most.max(value.abs()));
        if lead[column].abs() <= 1e-12 * scale.max(f64::MIN_POSITIVE) {
            return None;
        }
        for (_, row) in rows.iter_mut().enumerate().filter(|(i, _)| *i != column) {
            let factor = row[column] / lead[column];
            for (value, lead) in row.iter_mut().zip(lead) {
                *value -= factor * lead;
            }
        }
    }
    Some(std::array::from_fn(|i| rows[i][3] / rows[i][i]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixture::Fixture;
    use crate::progress::Silent;
    use image::RgbImage;

    #[test]
    fn the_fusion_finds_the_law_behind_most_vehicles_and_is_not_led_by_a_few_wrong_ones() {
        let mut rows: Vec<([f64; 3], f64)> = (1..60)
            .map(|i| {
                let size = 10.0 + f64::from(i);
                let matching = 12.0 + f64::from(i * 7 % 41);
                ([1.0, size, matching], 0.5 + 0.3 * size + 0.7 * matching)
            })
            .collect();
        for row in rows.iter_mut().step_by(12) {
            row.0[2] = 400.0;
        }
        let found = fit_fusion(&rows).unwrap();
        for (features, truth) in rows.iter().filter(|(features, _)| features[2] < 400.0) {
            let estimate: f64 = features.iter().zip(found).map(|(f, c)| f * c).sum();
            let error = estimate / truth - 1.0;
            assert!(error.abs() < 0.03, "{found:?} is off by {error}");
        }
    }

    #[test]
    fn equations_that_say_the_same_have_no_solution() {
        assert_eq!(fit_fusion(&[([1.0, 2.0, 3.0], 4.0)]), None);
        assert_eq!(fit_fusion(&[]), None);
    }

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
            let [network, size, triangulation, matching, fusion] =
                baselines.estimates(&sighting, &rig);
            assert_eq!((network, matching), (None, None));
            // Boxes are as wide as the depth says, not the distance.
            let size = size.unwrap();
            assert!((size / vehicle.distance_m - 1.0).abs() < 0.1, "{size}");
            let triangulation = triangulation.unwrap();
            assert!(
                (triangulation - vehicle.distance_m).abs() < 0.01,
                "{triangulation}"
            );
            assert_eq!(fusion, Some(size), "nothing to match in a black image");
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
