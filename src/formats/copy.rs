//! Images on their way from one dataset to another.

use std::fs;
use std::path::{Path, PathBuf};

use image::{ImageFormat, RgbImage, imageops};

use crate::error::{Error, Result};
use crate::files;
use crate::imaging;

/// Width and height of a picture as it is shown, pixels, from its header.
pub(super) fn dimensions(path: &Path) -> Result<[u32; 2]> {
    Ok(imaging::header(path)?.shown)
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
/// Pictures are turned as their files say, unless labels count in the pixels as they are `stored`.
/// What is not PNG or JPEG, or is turned, becomes PNG.
///
/// Returns the written file.
pub(super) fn place(
    source: &Path,
    folder: &Path,
    stem: &str,
    canvas: [u32; 2],
    stored: bool,
) -> Result<PathBuf> {
    let image = if stored {
        imaging::load_rgb(source)?
    } else {
        imaging::load_upright(source)?
    };
    let [width, height] = canvas;
    if image.dimensions() == (width, height) && !imaging::header(source)?.is_turned {
        let bytes = fs::read(source).map_err(Error::io("read", source))?;
        if let Some(extension) = usual_ending(&bytes) {
            let path = folder.join(format!("{stem}.{extension}"));
            files::write_atomically(&path, &bytes)?;
            return Ok(path);
        }
    }
    let path = folder.join(format!("{stem}.png"));
    if image.dimensions() == (width, height) {
        imaging::save_png(&path, &image)?;
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
    imaging::save_png(&path, &filled)?;
    Ok(path)
}

/// The ending of a file that every program reads; none for other kinds of image.
fn usual_ending(bytes: &[u8]) -> Option<&'static str> {
    match image::guess_format(bytes) {
        Ok(ImageFormat::Jpeg) => Some("jpg"),
        Ok(ImageFormat::Png) => Some("png"),
        _ => None,
    }
}

/// Copies an image file to `path`, which ends with `.png`; what is not PNG, or is turned, is encoded
/// anew.
pub(super) fn copy_as_png(source: &Path, path: &Path) -> Result<()> {
    let bytes = fs::read(source).map_err(Error::io("read", source))?;
    if usual_ending(&bytes) == Some("png") && !imaging::header(source)?.is_turned {
        return files::write_atomically(path, &bytes);
    }
    imaging::save_png(path, &imaging::load_upright(source)?)
}

/// Copies an image file into `folder` under the name `stem` with its own ending; what is not PNG or
/// JPEG, or is turned, becomes PNG. The file's name.
pub(super) fn copy_as_is(source: &Path, folder: &Path, stem: &str) -> Result<String> {
    let bytes = fs::read(source).map_err(Error::io("read", source))?;
    let usual = usual_ending(&bytes);
    let Some(extension) = usual.filter(|_| !imaging::header(source).is_ok_and(|h| h.is_turned))
    else {
        let name = format!("{stem}.png");
        imaging::save_png(folder.join(&name), &imaging::load_upright(source)?)?;
        return Ok(name);
    };
    let name = format!("{stem}.{extension}");
    files::write_atomically(folder.join(&name), &bytes)?;
    Ok(name)
}
