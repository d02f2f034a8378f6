//! The one of several calibrated resolutions that images have.

use crate::error::{Error, Result};

/// A principal point this near to the middle of images, as a part of their size, is that of a camera
/// in their resolution.
const OFF_CENTER: f64 = 0.025;

/// What a calibration says of one resolution.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Resolution<T> {
    /// Width and height, pixels, where they are known.
    pub size: Option<[u32; 2]>,
    /// The left camera's principal point, pixels of this crate.
    pub center: [f64; 2],
    /// What else there is to it.
    pub content: T,
}

/// Chooses the resolution of images: the one of their size; else one whose principal point is in
/// their middle, of which the size is not kept; else the least of the same shape that is larger,
/// or the largest.
pub(super) fn choose<T: Clone>(
    resolutions: &[Resolution<T>],
    images: Option<[u32; 2]>,
) -> Result<Resolution<T>> {
    let [first, rest @ ..] = resolutions else {
        return Err(Error::value(
            "resolutions",
            "there are none",
            "give a calibration with cameras in it",
        ));
    };
    let Some(images) = images else {
        if rest.is_empty() {
            return Ok(first.clone());
        }
        return Err(Error::value(
            "resolutions",
            format!("there are several: {}", sizes(resolutions)),
            "say the size of the images, which decides",
        ));
    };
    if let Some(same) = resolutions.iter().find(|one| one.size == Some(images)) {
        return Ok(same.clone());
    }
    let off_center = |one: &Resolution<T>| {
        let off = |i: usize| (2.0 * one.center[i] / f64::from(images[i]) - 1.0).abs();
        off(0).max(off(1))
    };
    let nearest = resolutions
        .iter()
        .min_by(|a, b| off_center(a).total_cmp(&off_center(b)));
    if let Some(nearest) = nearest.filter(|one| off_center(one) <= OFF_CENTER) {
        return Ok(Resolution {
            size: None,
            ..nearest.clone()
        });
    }
    // The same shape but for a pixel of rounding.
    let is_alike = |size: [u32; 2]| {
        let scale = f64::from(size[0]) / f64::from(images[0]);
        (f64::from(images[1]) * scale - f64::from(size[1])).abs() <= 1.0_f64.max(scale)
    };
    let mut alike: Vec<(u32, &Resolution<T>)> = resolutions
        .iter()
        .filter_map(|one| Some((one.size.filter(|size| is_alike(*size))?[0], one)))
        .collect();
    alike.sort_by_key(|(width, _)| *width);
    let larger = alike.iter().find(|(width, _)| *width >= images[0]);
    match larger.or(alike.last()) {
        Some((_, one)) => Ok((*one).clone()),
        None => Err(Error::value(
            format!("images of {}x{} pixels", images[0], images[1]),
            format!("the calibration is of images of {}", sizes(resolutions)),
            "give images as the calibrated cameras took them, or the same enlarged or shrunk \
             without cutting",
        )),
    }
}

fn sizes<T>(resolutions: &[Resolution<T>]) -> String {
    let shown = |one: &Resolution<T>| match one.size {
        Some([width, height]) => format!("{width}x{height}"),
        // Not known, but a camera sees about as far to both sides.
        None => format!(
            "about {:.0}x{:.0}",
            2.0 * one.center[0],
            2.0 * one.center[1]
        ),
    };
    let shown: Vec<String> = resolutions.iter().map(shown).collect();
    shown.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_have_the_resolution_of_their_size_their_middle_or_their_shape() {
        let one = |size: [u32; 2], name| Resolution {
            size: Some(size),
            center: size.map(|side| f64::from(side) / 2.0 + 3.0),
            content: name,
        };
        let all = [
            one([2208, 1242], "2k"),
            one([1920, 1080], "fhd"),
            one([1280, 720], "hd"),
            one([672, 376], "vga"),
        ];
        for (images, name, size) in [
            ([1920, 1080], "fhd", Some([1920, 1080])),
            ([672, 376], "vga", Some([672, 376])),
            // Cut by a few pixels only.
            ([1284, 720], "hd", None),
            // Resized.
            ([640, 360], "hd", Some([1280, 720])),
            ([1600, 900], "fhd", Some([1920, 1080])),
            ([3840, 2160], "2k", Some([2208, 1242])),
        ] {
            let chosen = choose(&all, Some(images)).unwrap();
            assert_eq!((chosen.content, chosen.size), (name, size), "{images:?}");
        }
        let message = choose(&all, Some([640, 480])).unwrap_err().to_string();
        assert!(
            message.contains("640x480") && message.contains("1280x720"),
            "{message}"
        );
        assert!(
            choose(&all, None)
                .unwrap_err()
                .to_string()
                .contains("several")
        );
        assert_eq!(choose(&all[2..3], None).unwrap().content, "hd");
        assert!(choose::<()>(&[], None).is_err());
    }
}
