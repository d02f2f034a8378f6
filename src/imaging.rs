//! Image files, PNG and JPEG in and out, and crops and maps resampled from images.
//!
//! Whatever is decoded becomes 8-bit RGB. Knows nothing of labels, datasets and tensors.

mod remap;
mod resample;

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::metadata::Orientation;
use image::{
    DynamicImage, ImageDecoder as _, ImageError, ImageFormat, ImageReader, Limits, RgbImage,
};

use crate::error::{Error, Result};

pub use remap::PixelMap;
pub use resample::{
    ChannelStatistics, PlaneWindow, crop_into_planes, crop_resized, planes_from_image,
};

/// The largest width and height that is decoded, pixels: the largest that a rig may have.
pub const MAX_SIDE_PX: u32 = 32_768;

/// The largest decoded image, bytes. 1 GiB is a 350-megapixel image; a small file that claims more
/// is a mistake or an attack.
const MAX_DECODED_BYTES: u64 = 1 << 30;

/// The largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 29;

/// Reads a PNG or JPEG file as 8-bit RGB.
///
/// The content decides the format, not the name. Greyscale is replicated to three channels, an
/// alpha channel is ignored, palettes are resolved, 16 bits become 8 by dividing by 257 and
/// rounding. Colour profiles and rotation notes are not applied: the pixels are taken as stored, which
/// is what the labels of datasets count in. [`load_upright`] applies rotation notes.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Image`] when it is neither PNG nor JPEG,
/// truncated, damaged, or larger than 32768 pixels a side, 512 MiB as a file or 1 GiB decoded.
pub fn load_rgb(path: impl AsRef<Path>) -> Result<RgbImage> {
    Ok(rgb_from(decode(path.as_ref())?.0))
}

/// [`load_rgb`], turned and mirrored as the file's Exif orientation says: as viewers show it, and as
/// OpenCV reads it for calibration.
///
/// # Errors
/// As [`load_rgb`]. An orientation that cannot be read is none.
pub fn load_upright(path: impl AsRef<Path>) -> Result<RgbImage> {
    let (mut decoded, orientation) = decode(path.as_ref())?;
    decoded.apply_orientation(orientation);
    Ok(rgb_from(decoded))
}

/// The pixels of a file as they are stored, and how they are to be turned.
fn decode(path: &Path) -> Result<(DynamicImage, Orientation)> {
    let too_large = |problem: String| {
        Error::image(
            path,
            problem,
            format!(
                "reduce it: at most {MAX_SIDE_PX} pixels a side, 512 MiB as a file, 1 GiB decoded"
            ),
        )
    };
    let metadata = fs::metadata(path).map_err(Error::io("read", path))?;
    if metadata.len() > MAX_FILE_BYTES {
        return Err(too_large(format!("the file has {} bytes", metadata.len())));
    }
    let bytes = fs::read(path).map_err(Error::io("read", path))?;
    if bytes.is_empty() {
        return Err(Error::image(path, "the file is empty", "write it again"));
    }
    let Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) = image::guess_format(&bytes) else {
        return Err(Error::image(
            path,
            "is neither a PNG nor a JPEG image",
            "convert it to PNG",
        ));
    };
    if format == ImageFormat::Jpeg && !jpeg_is_complete(&bytes) {
        return Err(Error::image(
            path,
            "cannot be decoded: the file is truncated",
            "copy or write it again",
        ));
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE_PX);
    limits.max_image_height = Some(MAX_SIDE_PX);
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    let refuse = |error: ImageError| match error {
        ImageError::Limits(error) => too_large(format!("is too large: {error}")),
        error => Error::image(
            path,
            format!("cannot be decoded: {error}"),
            "copy or write it again; the file may be truncated or damaged",
        ),
    };
    let mut decoder = reader.into_decoder().map_err(refuse)?;
    // The decoder's own limit is for what it needs beside the pixels.
    let (bytes, (width, height)) = (decoder.total_bytes(), decoder.dimensions());
    if bytes > MAX_DECODED_BYTES {
        return Err(too_large(format!(
            "is too large: {width}x{height} pixels are {bytes} bytes"
        )));
    }
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let decoded = DynamicImage::from_decoder(decoder).map_err(refuse)?;
    if decoded.width() == 0 || decoded.height() == 0 {
        return Err(Error::image(
            path,
            format!("has no pixels ({}x{})", decoded.width(), decoded.height()),
            "write it again",
        ));
    }
    Ok((decoded, orientation))
}

/// Whether the last scan of a JPEG file has its end marker.
///
/// The decoder fills the missing part of a truncated file with grey and reports nothing, which
/// would train a network on grey. In entropy-coded data a 0xFF byte is always followed by 0, so
/// an end marker after the last start of a scan is a real one.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    let last_scan = bytes.windows(2).rposition(|pair| pair == [0xFF, 0xDA]);
    last_scan.is_some_and(|start| bytes[start..].windows(2).any(|pair| pair == [0xFF, 0xD9]))
}

/// Any decoded image as 8-bit RGB, as [`load_rgb`] promises.
fn rgb_from(decoded: DynamicImage) -> RgbImage {
    let eight_bits = |value: u16| u8::try_from((u32::from(value) + 128) / 257).unwrap_or(u8::MAX);
    match decoded {
        DynamicImage::ImageRgb16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                image::Rgb(image.get_pixel(x, y).0.map(eight_bits))
            })
        }
        DynamicImage::ImageRgba16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                let [red, green, blue, _] = image.get_pixel(x, y).0;
                image::Rgb([red, green, blue].map(eight_bits))
            })
        }
        DynamicImage::ImageLuma16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                image::Rgb([eight_bits(image.get_pixel(x, y).0[0]); 3])
            })
        }
        DynamicImage::ImageLumaA16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                image::Rgb([eight_bits(image.get_pixel(x, y).0[0]); 3])
            })
        }
        eight_bit => eight_bit.into_rgb8(),
    }
}

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
