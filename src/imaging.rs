//! Image files in (PNG, JPEG, BMP, WebP, TIFF) and out (PNG, JPEG), and crops and maps resampled
//! from images.
//!
//! Whatever is decoded becomes 8-bit RGB. Knows nothing of labels, datasets and tensors.

mod decode;
mod jpeg;
mod kinds;
mod remap;
mod resample;

use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::{ImageFormat, RgbImage};

use crate::error::{Error, Result};

pub use decode::{ImageHeader, header, load_rgb, load_upright};
pub(crate) use kinds::READABLE;
pub use kinds::{FolderFiles, files_in, has_image_ending, is_image};
pub use remap::PixelMap;
pub use resample::{
    ChannelStatistics, PlaneWindow, crop_into_planes, crop_resized, planes_from_image,
};

/// The largest width and height that is decoded, pixels: the largest that a rig may have.
pub const MAX_SIDE_PX: u32 = 32_768;

/// The image as the bytes of a PNG file, the same on every machine.
///
/// # Errors
/// [`Error::Image`] naming `path`, the file that it is meant for, when the image has no pixels.
pub fn png_bytes(path: impl AsRef<Path>, image: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    image
        .write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png)
        .map_err(|error| {
            Error::image(
                path,
                format!(
                    "{}x{} pixels cannot be encoded: {error}",
                    image.width(),
                    image.height()
                ),
                "give an image with at least one pixel",
            )
        })?;
    Ok(bytes)
}

/// Quality of JPEG files: good enough to look at, small enough to mail.
const JPEG_QUALITY: u8 = 82;

/// The image as the bytes of a JPEG file, for people to look at.
///
/// # Errors
/// [`Error::Image`] naming `path`, the file that it is meant for, when the image has no pixels.
pub fn jpeg_bytes(path: impl AsRef<Path>, image: &RgbImage) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .encode_image(image)
        .map_err(|error| Error::image(path, error.to_string(), "report this as a bug"))?;
    Ok(bytes)
}

/// Writes a PNG file, whole or not at all.
///
/// # Errors
/// [`Error::Image`] for an image without pixels, [`Error::Io`] when the file cannot be written.
pub fn save_png(path: impl AsRef<Path>, image: &RgbImage) -> Result<()> {
    let path = path.as_ref();
    crate::files::write_atomically(path, &png_bytes(path, image)?)
}

/// Refuses a stereo pair whose images differ in size.
///
/// # Errors
/// [`Error::Image`] that names both files and their sizes.
pub fn check_pair(
    left_path: &Path,
    left: &RgbImage,
    right_path: &Path,
    right: &RgbImage,
) -> Result<()> {
    if left.dimensions() == right.dimensions() {
        return Ok(());
    }
    Err(Error::image(
        left_path,
        format!(
            "has {}x{} pixels but its partner {} has {}x{}",
            left.width(),
            left.height(),
            right_path.display(),
            right.width(),
            right.height()
        ),
        "give two images of the same rig, of equal size",
    ))
}

/// Reads both images of a stereo pair at the same time, upright; left first in the result.
///
/// # Errors
/// Those of [`load_upright`] and [`check_pair`].
pub fn load_pair(
    left_path: impl AsRef<Path>,
    right_path: impl AsRef<Path>,
) -> Result<[RgbImage; 2]> {
    let (left_path, right_path) = (left_path.as_ref(), right_path.as_ref());
    let (left, right) = rayon::join(|| load_upright(left_path), || load_upright(right_path));
    let (left, right) = (left?, right?);
    check_pair(left_path, &left, right_path, &right)?;
    Ok([left, right])
}

#[cfg(test)]
mod tests;
