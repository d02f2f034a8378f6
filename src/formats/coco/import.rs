//! COCO in.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rayon::prelude::*;

use super::super::ClassMap;
use super::super::draft::Draft;
use super::super::finder::Finder;
use super::super::flat::{Heap, HeapImage, HeapObject};
use super::super::importer::Importer;
use super::super::options::ImportOptions;
use super::files::{file_word, json_paths, read_file, speaks_of_coco, split_of};
use super::lenient::{Id, Number};
use super::{CocoAnnotation, CocoFile, CocoImage};
use crate::dataset::{BoxKind, FrameRow, Problem, Split};
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::imaging;

/// COCO's instance annotations.
pub(in super::super) struct Coco;

impl Importer for Coco {
    fn word(&self) -> &'static str {
        "coco"
    }

    fn name(&self) -> &'static str {
        "COCO"
    }

    fn layout(&self) -> &'static str {
        "annotations/*.json with images, annotations and categories, or SPLIT/_annotations.coco.json"
    }

    fn matches(&self, source: &Path) -> bool {
        json_paths(source).is_ok_and(|paths| paths.iter().any(|path| speaks_of_coco(path)))
    }

    /// `source` is a JSON file, or a folder with JSON files in it, in its folder `annotations` or in
    /// the folders of its splits. A file whose name, or whose folder's name, speaks of train, val or
    /// test gives its images to that split.
    fn read(
        &self,
        source: &Path,
        classes: Option<&ClassMap>,
        options: &ImportOptions,
    ) -> Result<Draft> {
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
        let classes = match classes {
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
            unlabelled: 0,
        };
        for (path, file) in &files {
            let reader = Reader::new(path, options.images.as_deref(), file, &classes);
            let outcomes: Vec<Result<Read, Problem>> = file
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
                    Ok(read) => {
                        heap.problems.extend(read.problems);
                        heap.images.push(read.image);
                    }
                    Err(problem) => heap.problems.push(problem),
                }
            }
        }
        heap.into_draft(options)
    }
}

/// What the images of one file are read with.
struct Reader<'a> {
    finder: Finder,
    /// What to do where an image is not found.
    remedy: &'static str,
    split: Option<Split>,
    annotations: BTreeMap<&'a Id, Vec<&'a CocoAnnotation>>,
    names: BTreeMap<&'a Id, &'a str>,
    classes: &'a ClassMap,
}

/// An image, and lesser things that were left out of it.
struct Read {
    image: HeapImage,
    problems: Vec<Problem>,
}

impl<'a> Reader<'a> {
    fn new(path: &Path, images: Option<&Path>, file: &'a CocoFile, classes: &'a ClassMap) -> Self {
        let word = file_word(path);
        let beside = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let folder = beside.canonicalize().unwrap_or(beside.to_path_buf());
        let folder_word = folder.file_name().unwrap_or_default().to_string_lossy();
        let split = split_of(&word).or_else(|| split_of(&folder_word));
        let above = beside.join("..");
        let set = word.strip_prefix("instances_").unwrap_or(&word);
        let (roots, below) = if let Some(images) = images {
            let images = images.to_path_buf();
            (vec![images.join(set), images.clone()], vec![images])
        } else {
            let roots = [beside, &above].into_iter().flat_map(|folder| {
                let inside = ["images", set].map(|name| folder.join(name));
                let deeper = folder.join("images").join(set);
                [
                    deeper,
                    inside[0].clone(),
                    inside[1].clone(),
                    folder.to_path_buf(),
                ]
            });
            let below = [beside.to_path_buf(), above.join("images"), above.join(set)];
            (roots.collect(), below.to_vec())
        };
        let mut annotations: BTreeMap<&Id, Vec<&CocoAnnotation>> = BTreeMap::new();
        for annotation in &file.annotations {
            annotations
                .entry(&annotation.image_id)
                .or_default()
                .push(annotation);
        }
        Self {
            finder: Finder::new(roots, below),
            remedy: if images.is_some() {
                "check the folder of --images"
            } else {
                "give its folder with --images"
            },
            split,
            annotations,
            names: file
                .categories
                .iter()
                .map(|category| (&category.id, category.name.as_str()))
                .collect(),
            classes,
        }
    }

    fn read(&self, image: &CocoImage) -> Result<Read, String> {
        let path = self
            .finder
            .find(&image.file_name)
            .map_err(|reason| format!("{reason}; {}", self.remedy))?;
        let header = imaging::header(&path).map_err(|error| error.to_string())?;
        let said = [image.width, image.height].map(|side| side.0.unwrap_or(0.0));
        let is_said = said.iter().all(|side| *side >= 1.0);
        let stored = is_said && said != header.shown.map(f64::from);
        if stored && said != header.stored.map(f64::from) {
            let [width, height] = header.shown;
            return Err(format!(
                "has {width}x{height} pixels and the annotations say {}x{}",
                said[0], said[1]
            ));
        }
        let size = if stored { header.stored } else { header.shown };
        let annotations = self.annotations.get(&image.id);
        let mut objects = Vec::new();
        let mut left_out: BTreeSet<&str> = BTreeSet::new();
        for annotation in annotations.into_iter().flatten() {
            let object = self.object(annotation, size).map_err(|reason| {
                let id = annotation.id.0.unwrap_or(f64::NAN);
                format!("annotation {id}: {reason}")
            })?;
            match object {
                Found::Object(object) => objects.push(object),
                Found::Other => {}
                Found::Nothing(reason) => {
                    left_out.insert(reason);
                }
            }
        }
        let problem = |reason: &str| Problem {
            subject: image.file_name.clone(),
            reason: reason.to_owned(),
        };
        Ok(Read {
            problems: left_out.into_iter().map(problem).collect(),
            image: HeapImage {
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
                stored,
            },
        })
    }

    fn object(
        &self,
        annotation: &CocoAnnotation,
        [width, height]: [u32; 2],
    ) -> Result<Found, String> {
        let name = self
            .names
            .get(&annotation.category_id)
            .ok_or_else(|| format!("category {} has no name", annotation.category_id))?;
        let Some(class) = self.classes.index_of(name) else {
            return Ok(Found::Other);
        };
        let Some(bbox) = &annotation.bbox else {
            return Err("has no bbox".to_owned());
        };
        let [Number(x), Number(y), Number(w), Number(h)] = bbox[..] else {
            return Err(format!("bbox has {} numbers, not 4", bbox.len()));
        };
        let (Some(x), Some(y), Some(w), Some(h)) = (x, y, w, h) else {
            return Err("bbox has an entry that is no number".to_owned());
        };
        let extra = annotation.twinsight.as_ref();
        let area = match extra.map(|extra| extra.edges) {
            Some([x_min, y_min, x_max, y_max]) => PixelBox::new(x_min, y_min, x_max, y_max),
            None if w == 0.0 || h == 0.0 => return Ok(Found::Nothing("a box has no size")),
            None => PixelBox::new(x, y, x + w, y + h),
        };
        let inside = area.clipped(f64::from(width), f64::from(height));
        if !area.is_valid() {
            return Err(format!("the box {x} {y} {w} {h} is empty or inverted"));
        }
        if !inside.is_valid() {
            return Ok(Found::Nothing("a box lies outside of the image"));
        }
        Ok(Found::Object(HeapObject {
            class,
            box_pixel: if extra.is_some() { area } else { inside },
            distance_m: extra.and_then(|extra| extra.distance_m),
            ignored: annotation.iscrowd.0.is_some_and(|crowd| crowd != 0.0),
            id: extra.map(|extra| extra.vehicle),
            center_pixel: extra.map(|extra| extra.center),
            visible: extra.and_then(|extra| extra.visible),
        }))
    }
}

/// What an annotation stands for.
enum Found {
    Object(HeapObject),
    /// An object of a class that is not wanted.
    Other,
    /// Nothing that can be seen, for this reason.
    Nothing(&'static str),
}

#[cfg(test)]
mod tests {
    use super::super::files::parse;
    use super::*;

    #[test]
    fn damaged_files_are_refused_or_read_and_nothing_else() {
        let seeds: [&[u8]; 3] = [
            br#"{"images": [{"id": 1, "file_name": "a.jpg", "width": 96, "height": 64}], "annotations": [{"id": 1, "image_id": 1, "category_id": 1, "bbox": [24, 16, 48, 32], "area": NaN, "iscrowd": null}], "categories": [{"id": 1, "name": "car"}]}"#,
            br#"{"images": [{"id": "1", "file_name": "C:\\a.jpg"}], "annotations": [{"image_id": 1.0, "category_id": "1", "bbox": ["24", 16.5, 0, 32]}], "categories": [{"id": 1.0, "name": "car"}], "info": {}}"#,
            br#"{"twinsight": {"kind": "tight"}, "images": [{"id": 1, "file_name": "a.jpg", "twinsight": {"scene": 3, "view": "front"}}], "annotations": [{"image_id": 1, "category_id": 1, "bbox": [1, 2, 3, 4], "twinsight": {"vehicle": 2, "distance_m": 12.5, "center": [3, 4], "edges": [1, 2, 4, 6]}}], "categories": [{"id": 1, "name": "car"}]}"#,
        ];
        crate::mutate::damaged(&seeds, |bytes| {
            let Ok(file) = parse(&String::from_utf8_lossy(bytes)) else {
                return;
            };
            let names = file.categories.iter().map(|category| category.name.clone());
            let classes = ClassMap::identity(names);
            let reader = Reader::new(Path::new("a.json"), None, &file, &classes);
            for annotation in &file.annotations {
                if let Ok(Found::Object(object)) = reader.object(annotation, [96, 64]) {
                    assert!(object.box_pixel.clipped(96.0, 64.0).is_valid());
                }
            }
        });
    }
}
