//! YOLO in.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Component, Path, PathBuf};

use rayon::prelude::*;

use super::super::copy;
use super::super::draft::ImportTarget;
use super::super::flat::{Heap, HeapImage, HeapObject, HeapOptions};
use super::super::report::ImportReport;
use super::super::{ClassMap, is_image};
use super::label::YoloLabel;
use super::{DataYaml, Names, Places};
use crate::dataset::{BoxKind, Problem, Split};
use crate::error::{Error, Result, yaml_problem};
use crate::files;
use crate::geometry::{PixelBox, StereoRig};
use crate::progress::Progress;

/// Imports a YOLO dataset: `source` is its `data.yaml` or the folder that holds it.
///
/// Images whose names say left and right become pairs, all others single images. An image without
/// a label file shows nothing.
///
/// # Errors
/// A `data.yaml` that is none, classes that it does not name, a target that is occupied, or no
/// usable image.
pub fn import(
    source: &Path,
    options: &HeapOptions,
    target: &ImportTarget,
    progress: &dyn Progress,
) -> Result<ImportReport> {
    let path = yaml_path(source)?;
    let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
    let yaml = read_yaml(&path)?;
    let kind = yaml
        .twinsight
        .as_ref()
        .map_or(BoxKind::Tight, |extra| extra.kind);
    let present = yaml.names.all();
    let classes = match &target.classes {
        Some(classes) => classes.clone(),
        None => ClassMap::identity(present.clone()),
    };
    if let Some(absent) = classes.absent(&present).first() {
        return Err(Error::dataset(
            &path,
            format!("has no class '{absent}'"),
            format!("choose among {}", present.join(", ")),
        ));
    }
    let places = [
        (Split::Train, &yaml.train),
        (Split::Val, &yaml.val),
        (Split::Test, &yaml.test),
    ];
    let mut images: BTreeMap<PathBuf, Split> = BTreeMap::new();
    for (split, places) in places {
        let places = match places {
            None => continue,
            Some(Places::One(place)) => std::slice::from_ref(place),
            Some(Places::Several(places)) => places,
        };
        for place in places {
            for image in images_at(&folder, yaml.path.as_deref(), place)? {
                // An image in several splits is learnt from: it can judge nothing.
                images.entry(image).or_insert(split);
            }
        }
    }
    let images: Vec<(PathBuf, Split)> = images.into_iter().collect();
    let outcomes: Vec<Result<HeapImage, Problem>> = images
        .par_iter()
        .map(|(path, split)| {
            let name = name_in(&folder, path);
            read_image(path, &name, *split, &yaml.names, &classes, kind).map_err(|reason| Problem {
                subject: name,
                reason,
            })
        })
        .collect();
    let mut heap = Heap {
        program: "twinsight import yolo",
        source: source.to_path_buf(),
        classes: classes.names(),
        kind,
        rig: yaml
            .twinsight
            .and_then(|extra| extra.rig)
            .map(StereoRig::try_from)
            .transpose()?,
        images: Vec::new(),
        problems: Vec::new(),
    };
    for outcome in outcomes {
        match outcome {
            Ok(image) => heap.images.push(image),
            Err(problem) => heap.problems.push(problem),
        }
    }
    heap.into_draft(options)?.write(target, progress)
}

/// The `data.yaml` of a folder, or its only YAML file.
fn yaml_path(source: &Path) -> Result<PathBuf> {
    if !source.is_dir() {
        return Ok(source.to_path_buf());
    }
    let usual = source.join("data.yaml");
    if usual.exists() {
        return Ok(usual);
    }
    let entries = fs::read_dir(source).map_err(Error::io("read", source))?;
    let is_yaml = |path: &PathBuf| {
        path.extension()
            .is_some_and(|ending| ending == "yaml" || ending == "yml")
    };
    let found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(is_yaml)
        .collect();
    match &found[..] {
        [path] => Ok(path.clone()),
        _ => Err(Error::dataset(
            source,
            "has no data.yaml",
            "give the file that names the classes and the images",
        )),
    }
}

fn read_yaml(path: &Path) -> Result<DataYaml> {
    let text = files::read_text(path)?;
    let yaml: DataYaml = serde_saphyr::from_str(&text).map_err(|error| {
        Error::dataset(
            path,
            format!("is no data.yaml: {}", yaml_problem(&error)),
            "it needs `names` with the classes and `train` with the folder of images",
        )
    })?;
    if yaml.train.is_none() && yaml.val.is_none() && yaml.test.is_none() {
        return Err(Error::dataset(
            path,
            "names no images",
            "it needs `train`, `val` or `test` with a folder of images",
        ));
    }
    Ok(yaml)
}

/// All images at a place that `data.yaml` names: a folder, a list, or one image.
fn images_at(folder: &Path, base: Option<&str>, place: &str) -> Result<Vec<PathBuf>> {
    // Tools disagree about what a path is relative to, and some write one `..` too many.
    let inner = Path::new(place)
        .components()
        .filter(|part| *part != Component::ParentDir)
        .collect::<PathBuf>();
    let candidates = [
        folder.join(base.unwrap_or_default()).join(place),
        folder.join(place),
        folder.join(inner),
    ];
    let Some(found) = candidates.iter().find(|path| path.exists()) else {
        return Err(Error::dataset(
            folder,
            format!("data.yaml names {place}, which is not there"),
            "correct the path in it; it may be relative to data.yaml",
        ));
    };
    if found.is_dir() {
        let mut images = Vec::new();
        collect_images(found, &mut images)?;
        return Ok(images);
    }
    if is_image(found) {
        return Ok(vec![found.clone()]);
    }
    let beside = found.parent().unwrap_or(folder);
    let text = files::read_text(found)?;
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    Ok(lines.map(|line| beside.join(line)).collect())
}

fn collect_images(folder: &Path, images: &mut Vec<PathBuf>) -> Result<()> {
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        if path.is_dir() {
            collect_images(&path, images)?;
        } else if is_image(&path) {
            images.push(path);
        }
    }
    Ok(())
}

/// Where the labels of an image are: in `labels` where the image is in `images`, else beside it.
fn label_path(image: &Path) -> PathBuf {
    let parts: Vec<Component<'_>> = image.components().collect();
    let last = parts.iter().rposition(|part| part.as_os_str() == "images");
    let path: PathBuf = (0..)
        .zip(parts)
        .map(|(i, part)| match part {
            _ if Some(i) == last => PathBuf::from("labels"),
            part => PathBuf::from(part.as_os_str()),
        })
        .collect();
    path.with_extension("txt")
}

/// A path inside the dataset, with `/`.
fn name_in(folder: &Path, path: &Path) -> String {
    let inside = path.strip_prefix(folder).unwrap_or(path);
    let parts = inside
        .components()
        .map(|part| part.as_os_str().to_string_lossy());
    parts.collect::<Vec<_>>().join("/")
}

/// The square that was cut off at one border of the image, as YOLO's boxes are: as long as its other
/// side. Cut off at two borders, or at opposite ones, it stays as it is.
fn whole_square(area: &PixelBox, [width, height]: [u32; 2]) -> PixelBox {
    let (width, height) = (f64::from(width), f64::from(height));
    let touched = [
        area.x_min <= 0.0,
        area.x_max >= width,
        area.y_min <= 0.0,
        area.y_max >= height,
    ];
    let side = area.width().max(area.height());
    let mut whole = *area;
    match touched {
        [true, false, false, false] => whole.x_min = area.x_max - side,
        [false, true, false, false] => whole.x_max = area.x_min + side,
        [false, false, true, false] => whole.y_min = area.y_max - side,
        [false, false, false, true] => whole.y_max = area.y_min + side,
        _ => {}
    }
    whole
}

fn read_image(
    path: &Path,
    name: &str,
    split: Split,
    names: &Names,
    classes: &ClassMap,
    kind: BoxKind,
) -> Result<HeapImage, String> {
    let size = copy::dimensions(path).map_err(|error| error.to_string())?;
    let label_path = label_path(path);
    let text = if label_path.exists() {
        files::read_text(&label_path).map_err(|error| error.to_string())?
    } else {
        String::new()
    };
    let mut objects = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let object = YoloLabel::parse(line, size)
            .and_then(|label| {
                let name = names.get(label.class);
                let name = name.ok_or_else(|| format!("class {} has no name", label.class))?;
                Ok(classes.index_of(name).map(|class| HeapObject {
                    class,
                    box_pixel: match kind {
                        BoxKind::Tight => label.box_pixel,
                        BoxKind::Sphere => whole_square(&label.box_pixel, size),
                    },
                    distance_m: label.distance_m,
                    ignored: false,
                    id: None,
                    center_pixel: None,
                    visible: None,
                }))
            })
            .map_err(|reason| {
                let file = label_path.file_name().unwrap_or_default().to_string_lossy();
                format!("{file} line {}: {reason}", index + 1)
            })?;
        objects.extend(object);
    }
    Ok(HeapImage {
        path: path.to_path_buf(),
        name: name.to_owned(),
        size,
        split: Some(split),
        row: None,
        objects,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_that_one_border_cut_off_is_whole_again() {
        let size = [100, 60];
        let whole = PixelBox::new(-4.0, 20.0, 16.0, 40.0);
        let mirrored = PixelBox::new(84.0, 20.0, 104.0, 40.0);
        let high = PixelBox::new(30.0, 50.0, 50.0, 70.0);
        for square in [whole, mirrored, high, PixelBox::new(30.0, 10.0, 50.0, 30.0)] {
            assert_eq!(whole_square(&square.clipped(100.0, 60.0), size), square);
        }
        // Nobody knows how much is missing.
        let at_both = PixelBox::new(0.0, 10.0, 100.0, 60.0);
        assert_eq!(whole_square(&at_both, size), at_both);
    }
}
