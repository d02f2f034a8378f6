//! Images on their way from one dataset to another.

use std::fs;
use std::path::{Path, PathBuf};

use image::{ImageFormat, ImageReader, RgbImage, imageops};

use crate::error::{Error, Result};
use crate::files;
use crate::imaging;

/// Width and height of an image file, pixels, from its header.
pub(super) fn dimensions(path: &Path) -> Result<[u32; 2]> {
    let reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(Error::io("read", path))?;
    let (width, height) = reader.into_dimensions().map_err(|error| {
        Error::image(
            path,
            format!("cannot be decoded: {error}"),
            "copy or write it again",
        )
    })?;
    Ok([width, height])
}

/// By how much an image has to shrink to fit on a canvas; 1 where it fits.
pub(super) fn scale_to_fit(size: [u32; 2], canvas: [u32; 2]) -> f64 {
    let part = |i: usize| f64::from(canvas[i]) / f64::from(size[i]);
    part(0).min(part(1)).min(1.0)
}

/// Puts an image file on a canvas in `folder` under the name `stem`: as it is where the size
/// agrees, otherwise shrunk to fit and filled up with black on the right and at the bottom, so that
/// pixel coordinates stay or scale. Every file is decoded once, so damaged ones are found here.
///
/// Returns the written file.
pub(super) fn place(source: &Path, folder: &Path, stem: &str, canvas: [u32; 2]) -> Result<PathBuf> {
    let image = imaging::load_rgb(source)?;
    let [width, height] = canvas;
    if image.dimensions() == (width, height) {
        let bytes = fs::read(source).map_err(Error::io("read", source))?;
        let extension = match image::guess_format(&bytes) {
            Ok(ImageFormat::Jpeg) => "jpg",
            _ => "png",
        };
        let path = folder.join(format!("{stem}.{extension}"));
        files::write_atomically(&path, &bytes)?;
        return Ok(path);
    }
    let scale = scale_to_fit([image.width(), image.height()], canvas);
    let image = if scale < 1.0 {
        let side = |length: u32| ((f64::from(length) * scale).round() as u32).max(1);
        let (width, height) = (side(image.width()), side(image.height()));
        imageops::resize(&image, width, height, imageops::FilterType::Triangle)
    } else {
        image
    };
    let mut filled = RgbImage::new(width, height);
    imageops::replace(&mut filled, &image, 0, 0);
    let path = folder.join(format!("{stem}.png"));
    imaging::save_png(&path, &filled)?;
    Ok(path)
}

/// Copies an image file to `path`, which ends with `.png`; a JPEG is encoded anew.
pub(super) fn copy_as_png(source: &Path, path: &Path) -> Result<()> {
    let bytes = fs::read(source).map_err(Error::io("read", source))?;
    if matches!(image::guess_format(&bytes), Ok(ImageFormat::Png)) {
        return files::write_atomically(path, &bytes);
    }
    imaging::save_png(path, &imaging::load_rgb(source)?)
}

/// Copies an image file into `folder` under the name `stem` with its own ending; the file's name.
pub(super) fn copy_as_is(source: &Path, folder: &Path, stem: &str) -> Result<String> {
    let bytes = fs::read(source).map_err(Error::io("read", source))?;
    let extension = match image::guess_format(&bytes) {
        Ok(ImageFormat::Jpeg) => "jpg",
        _ => "png",
    };
    let name = format!("{stem}.{extension}");
    files::write_atomically(folder.join(&name), &bytes)?;
    Ok(name)
}
