//! COCO in.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::super::ClassMap;
use super::super::copy;
use super::super::draft::ImportTarget;
use super::super::flat::{Heap, HeapImage, HeapObject, HeapOptions};
use super::super::report::ImportReport;
use super::{CocoAnnotation, CocoFile, CocoImage};
use crate::dataset::{BoxKind, FrameRow, Problem, Split};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{PixelBox, StereoRig};
use crate::progress::Progress;

/// Imports COCO annotations: `source` is a JSON file, or a folder with JSON files in it or in its
/// folder `annotations`. A file whose name speaks of train, val or test gives its images to that
/// split. `images` is the folder of the images where it is not found beside the files.
///
/// # Errors
/// A file that is not COCO's, a target that is occupied, or no usable image.
pub fn import(
    source: &Path,
    images: Option<&Path>,
    options: &HeapOptions,
    target: &ImportTarget,
    progress: &dyn Progress,
) -> Result<ImportReport> {
    let paths = json_paths(source)?;
    let mut files = Vec::new();
    for path in paths {
        let file = read_file(&path)?;
        files.push((path, file));
    }
    let mut present: Vec<String> = Vec::new();
    for category in files.iter().flat_map(|(_, file)| &file.categories) {
        if !present.contains(&category.name) {
            present.push(category.name.clone());
        }
    }
    let classes = match &target.classes {
        Some(classes) => classes.clone(),
        None => ClassMap::identity(present.clone()),
    };
    if let Some(absent) = classes.absent(&present).first() {
        return Err(Error::dataset(
            source,
            format!("has no category '{absent}'"),
            format!("choose among {}", present.join(", ")),
        ));
    }
    let extra = files.iter().find_map(|(_, file)| file.twinsight.as_ref());
    let rig = extra.and_then(|extra| extra.rig);
    let mut heap = Heap {
        program: "twinsight import coco",
        source: source.to_path_buf(),
        classes: classes.names(),
        kind: extra.map_or(BoxKind::Tight, |extra| extra.kind),
        rig: rig.map(StereoRig::try_from).transpose()?,
        images: Vec::new(),
        problems: Vec::new(),
    };
    for (path, file) in files {
        let reader = Reader::new(&path, images, &file, &classes);
        let outcomes: Vec<Result<HeapImage, Problem>> = file
            .images
            .par_iter()
            .map(|image| {
                reader.read(image).map_err(|reason| Problem {
                    subject: image.file_name.clone(),
                    reason,
                })
            })
            .collect();
        for outcome in outcomes {
            match outcome {
                Ok(image) => heap.images.push(image),
                Err(problem) => heap.problems.push(problem),
            }
        }
    }
    heap.into_draft(options)?.write(target, progress)
}

fn json_paths(source: &Path) -> Result<Vec<PathBuf>> {
    if !source.is_dir() {
        return Ok(vec![source.to_path_buf()]);
    }
    let inner = source.join("annotations");
    let folder = if inner.is_dir() {
        inner
    } else {
        source.to_path_buf()
    };
    let entries = fs::read_dir(&folder).map_err(Error::io("read", &folder))?;
    let mut found: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|ending| ending == "json"))
        .collect();
    // COCO's own folder has captions and key points beside the instances.
    let is_instances = |path: &PathBuf| file_word(path).starts_with("instances");
    if found.iter().any(is_instances) {
        found.retain(is_instances);
    }
    found.sort();
    if found.is_empty() {
        return Err(Error::dataset(
            folder,
            "holds no JSON file",
            "give the file of annotations",
        ));
    }
    Ok(found)
}

/// A file's name without folders and ending.
fn file_word(path: &Path) -> String {
    let stem = path.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

fn read_file(path: &Path) -> Result<CocoFile> {
    let text = files::read_text(path)?;
    serde_json::from_str(&text).map_err(|error| {
        Error::dataset(
            path,
            format!("is not COCO's: {error}"),
            "it needs the lists images, annotations and categories",
        )
    })
}

/// What the images of one file are read with.
struct Reader<'a> {
    folders: Vec<PathBuf>,
    split: Option<Split>,
    annotations: BTreeMap<u64, Vec<&'a CocoAnnotation>>,
    names: BTreeMap<u64, &'a str>,
    classes: &'a ClassMap,
}

impl<'a> Reader<'a> {
    fn new(path: &Path, images: Option<&Path>, file: &'a CocoFile, classes: &'a ClassMap) -> Self {
        let word = file_word(path);
        let split = Split::ALL
            .iter()
            .copied()
            .find(|split| word.contains(split.word()));
        let beside = path.parent().unwrap_or(Path::new("."));
        let above = beside.join("..");
        let set = word.strip_prefix("instances_").unwrap_or(&word);
        let folders = match images {
            Some(images) => vec![images.join(set), images.to_path_buf()],
            None => [beside, &above]
                .into_iter()
                .flat_map(|folder| {
                    let inside = ["images", set].map(|name| folder.join(name));
                    let deeper = folder.join("images").join(set);
                    [
                        deeper,
                        inside[0].clone(),
                        inside[1].clone(),
                        folder.to_path_buf(),
                    ]
                })
                .collect(),
        };
        let mut annotations: BTreeMap<u64, Vec<&CocoAnnotation>> = BTreeMap::new();
        for annotation in &file.annotations {
            annotations
                .entry(annotation.image_id)
                .or_default()
                .push(annotation);
        }
        Self {
            folders,
            split,
            annotations,
            names: file
                .categories
                .iter()
                .map(|category| (category.id, category.name.as_str()))
                .collect(),
            classes,
        }
    }

    fn read(&self, image: &CocoImage) -> Result<HeapImage, String> {
        let found = self
            .folders
            .iter()
            .map(|folder| folder.join(&image.file_name));
        let path = found
            .into_iter()
            .find(|path| path.exists())
            .ok_or("the image is not there; give its folder with --images")?;
        let size = copy::dimensions(&path).map_err(|error| error.to_string())?;
        if size != [image.width, image.height] {
            return Err(format!(
                "has {}x{} pixels and the annotations say {}x{}",
                size[0], size[1], image.width, image.height
            ));
        }
        let annotations = self
            .annotations
            .get(&image.id)
            .map_or(&[][..], Vec::as_slice);
        let mut objects = Vec::new();
        for annotation in annotations {
            let object = self
                .object(annotation, size)
                .map_err(|reason| format!("annotation {}: {reason}", annotation.id))?;
            objects.extend(object);
        }
        Ok(HeapImage {
            path,
            name: image.file_name.replace('\\', "/"),
            size,
            split: self.split,
            row: image.twinsight.as_ref().map(|extra| FrameRow {
                stamp: 0,
                split: Split::Train,
                scene: extra.scene,
                sun: extra.sun.clone(),
                view: extra.view,
                azimuth_deg: extra.azimuth_deg,
                elevation_deg: extra.elevation_deg,
                distance_m: extra.distance_m,
            }),
            objects,
        })
    }

    fn object(
        &self,
        annotation: &CocoAnnotation,
        [width, height]: [u32; 2],
    ) -> Result<Option<HeapObject>, String> {
        let name = self
            .names
            .get(&annotation.category_id)
            .ok_or_else(|| format!("category {} has no name", annotation.category_id))?;
        let Some(class) = self.classes.index_of(name) else {
            return Ok(None);
        };
        let [x, y, w, h] = annotation.bbox[..] else {
            return Err(format!("bbox has {} numbers, not 4", annotation.bbox.len()));
        };
        let extra = annotation.twinsight.as_ref();
        let area = match extra.map(|extra| extra.edges) {
            Some([x_min, y_min, x_max, y_max]) => PixelBox::new(x_min, y_min, x_max, y_max),
            None => PixelBox::new(x, y, x + w, y + h),
        };
        let inside = area.clipped(f64::from(width), f64::from(height));
        if !area.is_valid() || !inside.is_valid() {
            return Err(format!(
                "the box {x} {y} {w} {h} is empty or outside of the image"
            ));
        }
        Ok(Some(HeapObject {
            class,
            box_pixel: if extra.is_some() { area } else { inside },
            distance_m: extra.and_then(|extra| extra.distance_m),
            ignored: annotation.iscrowd != 0,
            id: extra.map(|extra| extra.vehicle),
            center_pixel: extra.map(|extra| extra.center),
            visible: extra.and_then(|extra| extra.visible),
        }))
    }
}
