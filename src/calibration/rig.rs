//! The rig of a calibration's images, and those images rectified.

use image::RgbImage;

use crate::error::{Error, Result};
use crate::geometry::{DisparityCorrection, Rectification, StereoCalibration, StereoRig};
use crate::imaging::PixelMap;
use crate::ranging::{RigNote, TrustedRig};

/// Whether images are as the cameras took them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum ImageState {
    /// As their size says where a calibration has different sizes for both; unrectified otherwise,
    /// unless the calibration is one of rectified images.
    #[default]
    Auto,
    /// As the cameras took them.
    Unrectified,
    /// Rectified with this calibration.
    Rectified,
}

/// How a calibration is used.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RigOptions {
    /// What the images are.
    pub images: ImageState,
    /// How much of unrectified images is kept, 0 to 1; see [`Rectification::new`].
    pub alpha: Option<f64>,
}

/// A calibration made ready for images of one size.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibratedRig {
    size: [u32; 2],
    rig: StereoRig,
    /// None for images that are rectified already.
    maps: Option<[PixelMap; 2]>,
    scaled_from: Option<[u32; 2]>,
    disparity_correction: Option<DisparityCorrection>,
}

impl CalibratedRig {
    /// Prepares for images of this size, width and height in pixels; computes the maps of
    /// rectification once for all of them.
    ///
    /// Images of the calibrated shape in another size are taken for the calibrated ones resized.
    ///
    /// # Errors
    /// Images of another shape, cameras that cannot be rectified, an `alpha` out of range.
    pub fn new(
        calibration: &StereoCalibration,
        size: [u32; 2],
        options: RigOptions,
    ) -> Result<Self> {
        let rectified_size = calibration
            .given()
            .and_then(|given| given.size)
            .or(calibration.size());
        let is_rectified = match options.images {
            ImageState::Rectified => true,
            ImageState::Unrectified => false,
            ImageState::Auto => {
                let differ = calibration.size().is_some() && rectified_size != calibration.size();
                calibration.is_rectified() || (differ && rectified_size == Some(size))
            }
        };
        let correction = |rig: &StereoRig| {
            let terms = calibration.disparity_correction();
            terms
                .map(|terms| DisparityCorrection::new(*terms, rig.left))
                .transpose()
        };
        if is_rectified {
            let rig = calibration.rectified_rig(size)?;
            return Ok(Self {
                size,
                rig,
                maps: None,
                scaled_from: rectified_size.filter(|own| *own != size),
                disparity_correction: correction(&rig)?,
            });
        }
        let rectification = Rectification::new(calibration, size, options.alpha)?;
        let target = [rectification.rig.left.width, rectification.rig.left.height];
        let maps = rectification.views.map(|view| {
            let widest = view.distortion.widest();
            PixelMap::new(size, target, |pixel| view.pixel_within(pixel, widest))
        });
        Ok(Self {
            size,
            rig: rectification.rig,
            maps: Some(maps),
            scaled_from: calibration.size().filter(|own| *own != size),
            disparity_correction: correction(&rectification.rig)?,
        })
    }

    /// The rig of the rectified images.
    pub fn rig(&self) -> &StereoRig {
        &self.rig
    }

    /// The rig of the rectified images with how far its disparities can be trusted: as well as the
    /// calibration says, or as those that nobody checked.
    pub fn trusted_rig(&self) -> TrustedRig {
        match self.disparity_correction {
            Some(correction) => TrustedRig::corrected(self.rig, correction),
            None => TrustedRig::unchecked(self.rig),
        }
    }

    /// What measured disparities of the rectified images are too large by, where the calibration says
    /// so.
    pub fn disparity_correction(&self) -> Option<&DisparityCorrection> {
        self.disparity_correction.as_ref()
    }

    /// Size of the images that it takes, pixels.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// The calibrated size, where it is another one than that of the images.
    pub fn scaled_from(&self) -> Option<[u32; 2]> {
        self.scaled_from
    }

    /// What there is to say of that.
    pub fn note(&self) -> Option<RigNote> {
        let images = self.size;
        self.scaled_from
            .map(|calibrated| RigNote::Resized { calibrated, images })
    }

    /// Whether images are changed at all.
    pub fn rectifies(&self) -> bool {
        self.maps.is_some()
    }

    /// Share of black pixels in the rectified left and right image, 0 to 1.
    pub fn black_shares(&self) -> [f64; 2] {
        match &self.maps {
            Some([left, right]) => [left.black_share(), right.black_share()],
            None => [0.0; 2],
        }
    }

    /// The pair rectified, left first: bilinear, black where the cameras saw nothing. Images that are
    /// rectified already come back as they are.
    ///
    /// # Errors
    /// Images of another size.
    pub fn rectify(&self, images: [RgbImage; 2]) -> Result<[RgbImage; 2]> {
        for image in &images {
            let size: [u32; 2] = image.dimensions().into();
            if size != self.size {
                return Err(Error::value(
                    format!("image of {}x{} pixels", size[0], size[1]),
                    format!(
                        "the calibration was made ready for {}x{}",
                        self.size[0], self.size[1]
                    ),
                    "give images of one size",
                ));
            }
        }
        let Some(maps) = &self.maps else {
            return Ok(images);
        };
        let [left, right] = images;
        let mapped = [maps[0].apply(&left), maps[1].apply(&right)];
        match mapped {
            [Some(left), Some(right)] => Ok([left, right]),
            _ => Ok([left, right]),
        }
    }
}
