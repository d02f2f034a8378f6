//! The calibration that is written: that of the images, with what was found.
//!
//! Rows that are off by less than a pixel do no harm to the matching of vehicles, which looks a row
//! up and down: such a calibration keeps its cameras, its images stay what they are, and only the
//! error of disparities is added to it. Where rows are off by more, the right camera is turned (pitch
//! and roll) and moved up or down in it, so that rectification resamples the images; the error of
//! disparities is then that of the newly rectified images. Yaw always remains an error of
//! disparities: the constant that belongs to it cannot be seen.

use glam::{DMat3, DQuat, DVec3};

use crate::calibration::{CalibratedRig, RigOptions};
use crate::error::Result;
use crate::geometry::{
    CalibrationParts, DisparityTerms, Rectification, RectifiedView, StereoCalibration, StereoRig,
};

use super::fit::RectificationFit;
use super::matching::FeatureMatch;
use super::reading::Reading;
use super::survey::Survey;

/// Rows that are off by more than this are worth resampling the images, pixels.
pub const MOST_ROWS_PX: f64 = 1.0;

/// A calibration to be written, and what features say of images rectified by it.
#[derive(Debug, Clone, PartialEq)]
pub struct Refined {
    /// The cameras; without an error of disparities so far.
    pub calibration: StereoCalibration,
    /// The rig of images rectified by it.
    pub rig: StereoRig,
    /// What is left in these.
    pub fit: RectificationFit,
    /// The matches in them.
    pub matches: Vec<FeatureMatch>,
    /// The known distances and their disparities in them.
    pub readings: Vec<Reading>,
    /// Whether the right camera was turned.
    pub is_turned: bool,
}

impl Refined {
    /// Refines the calibration of the images by what was found in them. `calibrated` is what
    /// `calibration` became with these `options`, and `survey` and `fit` are those of its rectified
    /// images.
    ///
    /// # Errors
    /// Cameras that cannot be rectified, or matches that all lie outside the rectified images.
    pub fn new(
        calibration: &StereoCalibration,
        options: RigOptions,
        calibrated: &CalibratedRig,
        survey: &Survey,
        fit: &RectificationFit,
    ) -> Result<Self> {
        let is_turned = fit.rows_off_px > MOST_ROWS_PX;
        let rig = *calibrated.rig();
        if !calibrated.rectifies() && !is_turned {
            let size = [rig.left.width, rig.left.height];
            let intrinsics = [rig.left.intrinsics(), rig.right.intrinsics()];
            return Ok(Self {
                calibration: StereoCalibration::rectified(Some(size), intrinsics, rig.baseline_m)?,
                rig,
                fit: fit.clone(),
                matches: survey.matches.clone(),
                readings: survey.readings.clone(),
                is_turned,
            });
        }
        let (parts, views) = if calibrated.rectifies() {
            let calibration = calibration.for_size(calibrated.size())?;
            let views = Rectification::new(&calibration, calibrated.size(), options.alpha)?.views;
            let parts = CalibrationParts {
                size: Some(calibrated.size()),
                cameras: *calibration.cameras(),
                rotation: calibration.right_from_left(),
                translation_m: calibration.translation_m(),
                given: None,
                disparity_correction: None,
            };
            (parts, Some(views))
        } else {
            let intrinsics = [rig.left.intrinsics(), rig.right.intrinsics()];
            let size = Some(calibrated.size());
            (
                CalibrationParts::rectified(size, intrinsics, rig.baseline_m),
                None,
            )
        };
        let parts = if is_turned {
            turned(parts, views.as_ref(), fit, rig.baseline_m)
        } else {
            parts
        };
        let refined = StereoCalibration::new(parts, Some(rig.baseline_m))?;
        let rectification = Rectification::new(&refined, calibrated.size(), options.alpha)?;
        let rig = rectification.rig;
        let moved = |pixels| moved(pixels, views.as_ref(), &rectification.views);
        let matches = survey.matches.iter().filter_map(|of| {
            let [left, right] = moved([of.left, of.right])?;
            Some(FeatureMatch { left, right, ..*of })
        });
        let matches: Vec<FeatureMatch> = matches.collect();
        let readings = survey.readings.iter();
        Ok(Self {
            calibration: refined,
            rig,
            fit: RectificationFit::new(&matches, &rig)?,
            matches,
            readings: readings
                .filter_map(|reading| reading.moved(moved(reading.pixels(&survey.rig))?, &rig))
                .collect(),
            is_turned,
        })
    }

    /// The calibration with an error of disparities.
    ///
    /// # Errors
    /// Terms that no rig has.
    pub fn with_correction(&self, terms: DisparityTerms) -> Result<StereoCalibration> {
        self.calibration.with_disparity_correction(Some(terms))
    }
}

/// The cameras with the right one turned and moved as the rows of rectified images say.
fn turned(
    parts: CalibrationParts,
    views: Option<&[RectifiedView; 2]>,
    fit: &RectificationFit,
    baseline_m: f64,
) -> CalibrationParts {
    let [left, right] = views.map_or([DMat3::IDENTITY; 2], |views| {
        views.each_ref().map(|view| view.camera_from_rectified)
    });
    // From rectified axes to those that the right camera turned out to have in their place.
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from_array(fit.turn())));
    let right_from_rectified = right * turn;
    let place_m = DVec3::new(baseline_m, -fit.rise() * baseline_m, 0.0);
    CalibrationParts {
        rotation: right_from_rectified * left.transpose(),
        translation_m: -(right_from_rectified * place_m),
        ..parts
    }
}

/// Pixels of a pair that is rectified one way in the pair rectified another way; None outside of it.
fn moved(
    [left, right]: [[f64; 2]; 2],
    before: Option<&[RectifiedView; 2]>,
    after: &[RectifiedView; 2],
) -> Option<[[f64; 2]; 2]> {
    let place = |side: usize, pixel: [f64; 2]| {
        let taken = match before {
            Some(views) => views[side].pixel_from_rectified(pixel)?,
            None => pixel,
        };
        let camera = after[side].rectified;
        let [x, y] = after[side].rectified_from_pixel(taken)?;
        let is_inside = (0.0..=f64::from(camera.width)).contains(&x)
            && (0.0..=f64::from(camera.height)).contains(&y);
        is_inside.then_some([x, y])
    };
    Some([place(0, left)?, place(1, right)?])
}
