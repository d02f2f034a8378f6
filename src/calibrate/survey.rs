//! Pairs of a rig looked through for features and for places whose distances are known.

use crate::calibration::CalibratedRig;
use crate::error::{Error, Result};
use crate::geometry::StereoRig;
use crate::progress::Progress;
use crate::sources::StereoFrame;

use super::known::KnownDistance;
use super::matching::{FeatureMatch, Matchable, matches};
use super::reading::{Reading, read};

/// Disparities of exchanged images are below this, pixels.
const NEGATIVE_PX: f64 = -2.0;

/// Disparities below this part of the image width are no small error of a rig but wrong matches.
const IMPOSSIBLE: f64 = -0.01;

/// Disparities within this are none, pixels.
const NONE_PX: f64 = 0.25;

/// Fewest features that tell exchanged images.
const TELLING: usize = 50;

/// Part of the features without disparity from which on a pair is one image twice.
const ALL: f64 = 0.95;

/// How pairs are looked through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SurveyOptions {
    /// Every so manieth pair is looked at, beside those with known distances; at least 1.
    pub every: u64,
    /// At most this many pairs are looked at, beside those with known distances.
    pub most_frames: usize,
    /// At most about this many corners of a left image are looked for in the right one.
    pub most_features: usize,
}

impl Default for SurveyOptions {
    fn default() -> Self {
        Self {
            every: 1,
            most_frames: 100,
            most_features: 3000,
        }
    }
}

/// What pairs show.
#[derive(Debug, Clone, PartialEq)]
pub struct Survey {
    /// The rig of the images that everything was measured in.
    pub rig: StereoRig,
    /// Features found in both images of a pair; their frame is an index into `frames`.
    pub matches: Vec<FeatureMatch>,
    /// Names of the pairs that were looked at.
    pub frames: Vec<String>,
    /// Pairs that could not be used, and why.
    pub unusable: Vec<String>,
    /// Known distances with the disparities measured there.
    pub readings: Vec<Reading>,
    /// Known distances whose disparities could not be measured, and why.
    pub unread: Vec<String>,
}

/// Looks through the frames of a rig, unrectified where the rig rectifies.
///
/// # Errors
/// [`Error::Value`] where no frame can be used, where left and right are exchanged or the same, and
/// for known distances of frames that are not there; [`Error::Interrupted`].
pub fn survey(
    frames: impl Iterator<Item = StereoFrame>,
    calibrated: &CalibratedRig,
    known: &[KnownDistance],
    options: SurveyOptions,
    progress: &dyn Progress,
) -> Result<Survey> {
    let mut survey = Survey {
        rig: *calibrated.rig(),
        matches: Vec::new(),
        frames: Vec::new(),
        unusable: Vec::new(),
        readings: Vec::new(),
        unread: Vec::new(),
    };
    let mut met = vec![false; known.len()];
    let mut same = 0;
    let mut taken = 0;
    for frame in frames {
        if progress.interrupted() {
            return Err(Error::Interrupted {
                resume: "nothing was written; run the same command again".to_owned(),
            });
        }
        let wanted: Vec<usize> = (0..known.len())
            .filter(|index| known[*index].is_of(&frame))
            .collect();
        for index in &wanted {
            met[*index] = true;
        }
        let is_due =
            frame.index.is_multiple_of(options.every.max(1)) && taken < options.most_frames;
        if is_due || !wanted.is_empty() {
            taken += usize::from(is_due);
            let of_frame: Vec<&KnownDistance> = wanted.iter().map(|i| &known[*i]).collect();
            if survey.add(frame, calibrated, &of_frame, options) {
                same += 1;
            }
        }
        progress.advance(1);
        progress.status(&format!("{} features", survey.matches.len()));
        if taken >= options.most_frames && met.iter().all(|met| *met) {
            break;
        }
    }
    if let Some(index) = met.iter().position(|met| !met) {
        let KnownDistance { line, image, .. } = &known[index];
        return Err(Error::value(
            format!("known distances, line {line}: image {image}"),
            "is none of the pairs",
            "give the name of a frame, or of its left image's file",
        ));
    }
    survey.check(same)?;
    let width = f64::from(survey.rig.left.width);
    let rig = survey.rig;
    survey
        .matches
        .retain(|of| disparity_px(of, &rig) > (IMPOSSIBLE * width).min(NEGATIVE_PX));
    Ok(survey)
}

fn disparity_px(of: &FeatureMatch, rig: &StereoRig) -> f64 {
    rig.disparity_of_pixels(of.left[0], of.right[0])
}

impl Survey {
    /// Adds a frame, or why not; true for one image twice.
    fn add(
        &mut self,
        frame: StereoFrame,
        calibrated: &CalibratedRig,
        known: &[&KnownDistance],
        options: SurveyOptions,
    ) -> bool {
        let images = match frame.images.and_then(|images| calibrated.rectify(images)) {
            Ok(images) => images,
            Err(error) => {
                self.unusable.push(format!("{}: {error}", frame.name));
                return false;
            }
        };
        // Where a camera saw nothing, both images are alike.
        let is_same = images[0] == images[1];
        let [left, right] = &images;
        let (left, right) = rayon::join(|| Matchable::new(left), || Matchable::new(right));
        let pair = [&left, &right];
        let number = self.frames.len() as u32;
        let offset_px = self.rig.left.center_x_px - self.rig.right.center_x_px;
        if !is_same {
            let found = matches(pair, number, offset_px, options.most_features);
            self.matches.extend(found);
        }
        for known in known {
            match read(known, &frame.name, pair, &self.rig) {
                Ok(reading) => self.readings.push(reading),
                Err(reason) => self.unread.push(format!("line {}: {reason}", known.line)),
            }
        }
        self.frames.push(frame.name);
        is_same
    }

    /// Refuses what is no stereo recording; `same` frames show one image twice.
    fn check(&self, same: usize) -> Result<()> {
        if self.frames.is_empty() {
            let (problem, remedy) = match self.unusable.first() {
                Some(first) => (format!("none can be used: {first}"), "mend it"),
                None => ("there are none".to_owned(), "give some"),
            };
            return Err(Error::value("pairs", problem, remedy));
        }
        let identical = || {
            Error::value(
                "left and right images",
                "are the same",
                "give the right camera's images as the second input",
            )
        };
        if same == self.frames.len() {
            return Err(identical());
        }
        let disparities: Vec<f64> = self
            .matches
            .iter()
            .map(|of| disparity_px(of, &self.rig))
            .collect();
        let count = |is: &dyn Fn(&&f64) -> bool| disparities.iter().filter(is).count();
        let total = disparities.len();
        let negative = count(&|d| **d < NEGATIVE_PX);
        if total >= TELLING && 2 * negative > total {
            return Err(Error::value(
                "left and right images",
                format!(
                    "look exchanged: {negative} of {total} features lie further right in the right image"
                ),
                "give the left camera's images first",
            ));
        }
        let without = count(&|d| d.abs() < NONE_PX);
        if total >= TELLING && without as f64 >= ALL * total as f64 {
            return Err(identical());
        }
        Ok(())
    }
}
