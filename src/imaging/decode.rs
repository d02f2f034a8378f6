//! Image files to pixels, as they are stored or as they are shown.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::metadata::Orientation;
use image::{
    DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader, Limits, Rgb, RgbImage,
};

use super::kinds::{READABLE, readable};
use super::{MAX_SIDE_PX, jpeg};
use crate::error::{Error, Result};

/// The largest decoded image, bytes. 1 GiB is a 350-megapixel image; a small file that claims more
/// is a mistake or an attack.
const MAX_DECODED_BYTES: u64 = 1 << 30;

/// The largest file that is read, bytes.
const MAX_FILE_BYTES: u64 = 1 << 29;

/// Reads an image file (PNG, JPEG, BMP, WebP or TIFF) as 8-bit RGB.
///
/// The content decides the format, not the name. Greyscale is replicated to three channels, an
/// alpha channel is ignored, palettes are resolved, 16 bits become 8 by dividing by 257 and
/// rounding. JPEG files without Huffman tables, as webcams send them, have the standard ones.
/// Colour profiles and rotation notes are not applied: the pixels are taken as stored.
/// [`load_upright`] applies rotation notes, as people see the picture and label it.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Image`] when it is none of these,
/// truncated, damaged, or larger than 32768 pixels a side, 512 MiB as a file or 1 GiB decoded.
pub fn load_rgb(path: impl AsRef<Path>) -> Result<RgbImage> {
    let path = path.as_ref();
    Ok(rgb_from(decode(path, read(path)?)?.0))
}

/// [`load_rgb`], turned and mirrored as the file's Exif orientation says: as viewers show it, as
/// OpenCV reads it for calibration, and as boxes that were drawn on it count.
///
/// # Errors
/// As [`load_rgb`]. An orientation that cannot be read is none.
pub fn load_upright(path: impl AsRef<Path>) -> Result<RgbImage> {
    upright(path.as_ref(), read(path.as_ref())?)
}

/// The picture of a file's bytes, turned as they say.
fn upright(path: &Path, bytes: Vec<u8>) -> Result<RgbImage> {
    let (mut decoded, orientation) = decode(path, bytes)?;
    decoded.apply_orientation(orientation);
    Ok(rgb_from(decoded))
}

/// What an image file's header says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageHeader {
    /// Width and height as the pixels are stored.
    pub stored: [u32; 2],
    /// Width and height as the picture is shown: exchanged where it is turned by 90 degrees.
    pub shown: [u32; 2],
    /// Whether it is shown otherwise than it is stored, turned or mirrored.
    pub is_turned: bool,
}

/// Reads an image's header.
///
/// # Errors
/// As [`load_rgb`], but damage behind the header is not noticed.
pub fn header(path: impl AsRef<Path>) -> Result<ImageHeader> {
    let path = path.as_ref();
    let (_, orientation, stored) = open(path, read(path)?)?;
    let swaps = matches!(
        orientation,
        Orientation::Rotate90
            | Orientation::Rotate270
            | Orientation::Rotate90FlipH
            | Orientation::Rotate270FlipH
    );
    let [width, height] = stored;
    Ok(ImageHeader {
        stored,
        shown: if swaps { [height, width] } else { stored },
        is_turned: orientation != Orientation::NoTransforms,
    })
}

fn too_large(path: &Path, problem: String) -> Error {
    Error::image(
        path,
        problem,
        format!("reduce it: at most {MAX_SIDE_PX} pixels a side, 512 MiB as a file, 1 GiB decoded"),
    )
}

/// What the decoder says against a file.
fn refused(path: &Path, error: &ImageError) -> Error {
    match error {
        ImageError::Limits(error) => too_large(path, format!("is too large: {error}")),
        error => Error::image(
            path,
            format!("cannot be decoded: {error}"),
            "copy or write it again; the file may be truncated or damaged",
        ),
    }
}

/// The bytes of a file.
fn read(path: &Path) -> Result<Vec<u8>> {
    let metadata = fs::metadata(path).map_err(Error::io("read", path))?;
    if metadata.len() > MAX_FILE_BYTES {
        return Err(too_large(
            path,
            format!("the file has {} bytes", metadata.len()),
        ));
    }
    fs::read(path).map_err(Error::io("read", path))
}

/// A file's decoder, how its picture is to be turned, and its width and height as stored.
fn open(path: &Path, mut bytes: Vec<u8>) -> Result<(impl ImageDecoder, Orientation, [u32; 2])> {
    if bytes.is_empty() {
        return Err(Error::image(path, "the file is empty", "write it again"));
    }
    let Some(format) = readable(&bytes) else {
        return Err(Error::image(
            path,
            format!("is not a {READABLE} image"),
            "convert it to PNG",
        ));
    };
    if format == ImageFormat::Jpeg {
        if !jpeg::is_complete(&bytes) {
            return Err(Error::image(
                path,
                "cannot be decoded: the file is truncated",
                "copy or write it again",
            ));
        }
        bytes = jpeg::with_tables(bytes);
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE_PX);
    limits.max_image_height = Some(MAX_SIDE_PX);
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    let mut decoder = reader
        .into_decoder()
        .map_err(|error| refused(path, &error))?;
    // The decoder's own limit is for what it needs beside the pixels.
    let (bytes, (width, height)) = (decoder.total_bytes(), decoder.dimensions());
    if bytes > MAX_DECODED_BYTES {
        return Err(too_large(
            path,
            format!("is too large: {width}x{height} pixels are {bytes} bytes"),
        ));
    }
    if width == 0 || height == 0 {
        return Err(Error::image(
            path,
            format!("has no pixels ({width}x{height})"),
            "write it again",
        ));
    }
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    Ok((decoder, orientation, [width, height]))
}

/// The pixels of a file as they are stored, and how they are to be turned.
fn decode(path: &Path, bytes: Vec<u8>) -> Result<(DynamicImage, Orientation)> {
    let (decoder, orientation, _) = open(path, bytes)?;
    let decoded = DynamicImage::from_decoder(decoder).map_err(|error| refused(path, &error))?;
    Ok((decoded, orientation))
}

/// Any decoded image as 8-bit RGB, as [`load_rgb`] promises.
fn rgb_from(decoded: DynamicImage) -> RgbImage {
    let eight_bits = |value: u16| u8::try_from((u32::from(value) + 128) / 257).unwrap_or(u8::MAX);
    match decoded {
        DynamicImage::ImageRgb16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                Rgb(image.get_pixel(x, y).0.map(eight_bits))
            })
        }
        DynamicImage::ImageRgba16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                let [red, green, blue, _] = image.get_pixel(x, y).0;
                Rgb([red, green, blue].map(eight_bits))
            })
        }
        DynamicImage::ImageLuma16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                Rgb([eight_bits(image.get_pixel(x, y).0[0]); 3])
            })
        }
        DynamicImage::ImageLumaA16(image) => {
            RgbImage::from_fn(image.width(), image.height(), |x, y| {
                Rgb([eight_bits(image.get_pixel(x, y).0[0]); 3])
            })
        }
        eight_bit => eight_bit.into_rgb8(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mutate::damaged;

    #[test]
    fn damaged_images_of_all_kinds_are_refused_or_read_and_nothing_else() {
        let image = RgbImage::from_fn(24, 16, |x, y| Rgb([(x * 9) as u8, (y * 14) as u8, 7]));
        let formats = [
            ImageFormat::Png,
            ImageFormat::Jpeg,
            ImageFormat::Bmp,
            ImageFormat::WebP,
            ImageFormat::Tiff,
        ];
        let files = formats.map(|format| {
            let mut bytes = Vec::new();
            image
                .write_to(&mut Cursor::new(&mut bytes), format)
                .unwrap();
            bytes
        });
        let seeds = files.each_ref().map(Vec::as_slice);
        damaged(&seeds, |bytes| {
            if let Ok(image) = upright(Path::new("damaged"), bytes.to_vec()) {
                assert!(image.width() > 0 && image.height() > 0);
            }
        });
    }
}
