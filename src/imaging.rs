//! Image files, PNG and JPEG in and out, and crops and maps resampled from images.
//!
//! Whatever is decoded becomes 8-bit RGB. Knows nothing of labels, datasets and tensors.

mod remap;
mod resample;

use std::fs;
use std::io::Cursor;
use std::path::Path;

use image::codecs::jpeg::JpegEncoder;
use image::{DynamicImage, ImageFormat, ImageReader, Limits, RgbImage};

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
/// rounding. Colour profiles and rotation notes are not applied: the pixels are taken as stored.
///
/// # Errors
/// [`Error::Io`] when the file cannot be read; [`Error::Image`] when it is neither PNG nor JPEG,
/// truncated, damaged, or larger than 32768 pixels a side, 512 MiB as a file or 1 GiB decoded.
pub fn load_rgb(path: impl AsRef<Path>) -> Result<RgbImage> {
    let path = path.as_ref();
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
    let decoded = reader.decode().map_err(|error| match error {
        image::ImageError::Limits(error) => too_large(format!("is too large: {error}")),
        error => Error::image(
            path,
            format!("cannot be decoded: {error}"),
            "copy or write it again; the file may be truncated or damaged",
        ),
    })?;
    let rgb = rgb_from(decoded);
    if rgb.width() == 0 || rgb.height() == 0 {
        return Err(Error::image(
            path,
            format!("has no pixels ({}x{})", rgb.width(), rgb.height()),
            "write it again",
        ));
    }
    Ok(rgb)
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

/// Reads both images of a stereo pair at the same time; left first in the result.
///
/// # Errors
/// Those of [`load_rgb`] and [`check_pair`].
pub fn load_pair(
    left_path: impl AsRef<Path>,
    right_path: impl AsRef<Path>,
) -> Result<[RgbImage; 2]> {
    let (left_path, right_path) = (left_path.as_ref(), right_path.as_ref());
    let (left, right) = rayon::join(|| load_rgb(left_path), || load_rgb(right_path));
    let (left, right) = (left?, right?);
    check_pair(left_path, &left, right_path, &right)?;
    Ok([left, right])
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, Luma, Rgb, Rgba, RgbaImage};

    fn noise(width: u32, height: u32) -> RgbImage {
        RgbImage::from_fn(width, height, |x, y| {
            let value = x * 37 + y * 101 + x * y;
            Rgb([value as u8, (value / 3) as u8, (value / 7) as u8])
        })
    }

    fn message(path: &Path) -> String {
        load_rgb(path).unwrap_err().to_string()
    }

    #[test]
    fn a_written_image_comes_back_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        save_png(&path, &noise(31, 17)).unwrap();
        assert_eq!(load_rgb(&path).unwrap(), noise(31, 17));
    }

    #[test]
    fn a_missing_file_is_named_with_a_remedy() {
        let text = message(Path::new("nowhere/left_00001.png"));
        assert!(
            text.contains("left_00001.png") && text.contains("check the path"),
            "{text}"
        );
    }

    #[test]
    fn truncated_files_are_refused_at_any_length() {
        let folder = tempfile::tempdir().unwrap();
        let png = png_bytes("a.png", &noise(64, 48)).unwrap();
        let mut jpeg = Vec::new();
        noise(64, 48)
            .write_to(&mut Cursor::new(&mut jpeg), ImageFormat::Jpeg)
            .unwrap();
        for (name, bytes, format) in [
            ("a.png", png, ImageFormat::Png),
            ("a.jpg", jpeg, ImageFormat::Jpeg),
        ] {
            let path = folder.path().join(name);
            // A PNG is complete without its 12-byte end chunk.
            let shortest_loss = if format == ImageFormat::Png { 14 } else { 1 };
            for length in [0, 1, 8, 40, bytes.len() / 2, bytes.len() - shortest_loss] {
                fs::write(&path, &bytes[..length]).unwrap();
                let text = message(&path);
                assert!(text.contains(name), "{length} bytes of {name}: {text}");
            }
            fs::write(&path, &bytes).unwrap();
            load_rgb(&path).unwrap();
        }
    }

    #[test]
    fn damaged_bytes_and_other_formats_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let mut bytes = png_bytes("a.png", &noise(64, 48)).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 0x55;
        fs::write(&path, &bytes).unwrap();
        assert!(message(&path).contains("cannot be decoded"));
        fs::write(&path, "id class x_min").unwrap();
        assert!(message(&path).contains("neither a PNG nor a JPEG"));
    }

    #[test]
    fn a_small_file_that_claims_an_enormous_image_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        for (width, height) in [(2_000_000_u32, 2_000_000_u32), (32_000, 32_000), (0, 5)] {
            let mut bytes = png_bytes("a.png", &noise(2, 2)).unwrap();
            bytes[16..20].copy_from_slice(&width.to_be_bytes());
            bytes[20..24].copy_from_slice(&height.to_be_bytes());
            let crc = crc32(&bytes[12..29]).to_be_bytes();
            bytes[29..33].copy_from_slice(&crc);
            let path = folder.path().join(format!("{width}.png"));
            fs::write(&path, &bytes).unwrap();
            let text = message(&path);
            assert!(
                text.starts_with("image ") && text.contains(".png"),
                "{text}"
            );
            assert!(width == 0 || text.contains("too large"), "{text}");
        }
    }

    /// The checksum of PNG chunks.
    fn crc32(bytes: &[u8]) -> u32 {
        !bytes.iter().fold(!0, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
                if crc & 1 == 1 {
                    crc >> 1 ^ 0xEDB8_8320
                } else {
                    crc >> 1
                }
            })
        })
    }

    #[test]
    fn greyscale_alpha_and_sixteen_bits_become_eight_bit_rgb() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let grey = GrayImage::from_fn(3, 2, |x, y| Luma([(x * 40 + y) as u8]));
        grey.save(&path).unwrap();
        assert_eq!(load_rgb(&path).unwrap().get_pixel(2, 1).0, [81; 3]);

        // A transparent pixel keeps its colour: alpha is ignored, not blended.
        RgbaImage::from_pixel(3, 2, Rgba([9, 8, 7, 0]))
            .save(&path)
            .unwrap();
        assert_eq!(load_rgb(&path).unwrap().get_pixel(0, 0).0, [9, 8, 7]);

        // 128 and 129 lie on either side of a half of 257.
        let deep: ImageBuffer<Rgb<u16>, _> =
            ImageBuffer::from_pixel(3, 2, Rgb([128, 129, 65_535_u16]));
        deep.save(&path).unwrap();
        assert_eq!(load_rgb(&path).unwrap().get_pixel(0, 0).0, [0, 1, 255]);

        let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_pixel(3, 2, Luma([25_700_u16]));
        deep.save(&path).unwrap();
        assert_eq!(load_rgb(&path).unwrap().get_pixel(0, 0).0, [100; 3]);
    }

    #[test]
    fn a_pair_of_unequal_sizes_is_refused_naming_both_files_and_sizes() {
        let folder = tempfile::tempdir().unwrap();
        let (left, right) = (
            folder.path().join("left_1.png"),
            folder.path().join("right_1.png"),
        );
        save_png(&left, &noise(8, 6)).unwrap();
        save_png(&right, &noise(8, 5)).unwrap();
        let text = load_pair(&left, &right).unwrap_err().to_string();
        for word in ["left_1.png", "8x6", "right_1.png", "8x5"] {
            assert!(text.contains(word), "{text} should contain {word}");
        }
    }
}
