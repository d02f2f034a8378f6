//! YOLO in.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::super::copy;
use super::super::draft::Draft;
use super::super::flat::{Heap, HeapImage, HeapObject};
use super::super::importer::Importer;
use super::super::options::ImportOptions;
use super::super::{ClassMap, skipped};
use super::data_yaml::DataYaml;
use super::images::{PlaceImages, images_at, label_places, name_in};
use super::label::{Line, LineShape, YoloLabel};
use crate::dataset::{BoxKind, Problem, Split};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{PixelBox, StereoRig};

/// What is said of numbers behind the boxes.
const CONFIDENCE: &str = "a sixth number is taken for a confidence, not for a distance; where it is \
                          metres, say --distance-column";

/// YOLO's text files.
pub(in super::super) struct Yolo;

impl Importer for Yolo {
    fn word(&self) -> &'static str {
        "yolo"
    }

    fn name(&self) -> &'static str {
        "YOLO"
    }

    fn layout(&self) -> &'static str {
        "data.yaml with names and train, images/*.jpg, labels/*.txt"
    }

    fn matches(&self, source: &Path) -> bool {
        let path = yaml_path(source).ok();
        path.is_some_and(|path| path.is_file() && DataYaml::read(&path).is_ok())
    }

    /// Images whose names say left and right become pairs, all others single images. An image
    /// without a label file shows nothing.
    fn read(
        &self,
        source: &Path,
        classes: Option<&ClassMap>,
        options: &ImportOptions,
    ) -> Result<Draft> {
        let path = yaml_path(source)?;
        let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
        let yaml = DataYaml::read(&path)?;
        let present = yaml.class_names();
        let classes = match classes {
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
        let mut problems = Vec::new();
        let images = labelled_images(&folder, &yaml, options, &mut problems)?;
        let reader = Reader {
            kind: yaml
                .twinsight
                .as_ref()
                .map_or(BoxKind::Tight, |extra| extra.kind),
            shape: yaml.line_shape(options.distance_column),
            names: &yaml.names,
            classes: &classes,
        };
        let outcomes: Vec<Result<Read, Problem>> = images
            .par_iter()
            .map(|(path, image)| {
                let name = name_in(&folder, path);
                reader.read(path, &name, image).map_err(|reason| Problem {
                    subject: name,
                    reason,
                })
            })
            .collect();
        let mut heap = Heap {
            program: "twinsight import yolo",
            source: source.to_path_buf(),
            classes: classes.names(),
            kind: reader.kind,
            rig: yaml
                .twinsight
                .as_ref()
                .and_then(|extra| extra.rig)
                .map(StereoRig::try_from)
                .transpose()?,
            images: Vec::new(),
            problems,
            unlabelled: images.values().filter(|i| i.labels.is_none()).count(),
        };
        for outcome in outcomes {
            match outcome {
                Ok(read) => {
                    heap.problems.extend(read.problems);
                    heap.images.push(read.image);
                }
                Err(problem) => heap.problems.push(problem),
            }
        }
        heap.into_draft(options)
    }
}

/// The `data.yaml` of a folder, or its only YAML file.
fn yaml_path(source: &Path) -> Result<PathBuf> {
    if !source.is_dir() {
        return Ok(source.to_path_buf());
    }
    let usual = ["data.yaml", "data.yml", "dataset.yaml"].map(|name| source.join(name));
    if let Some(usual) = usual.into_iter().find(|path| path.exists()) {
        return Ok(usual);
    }
    let entries = std::fs::read_dir(source).map_err(Error::io("read", source))?;
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

/// An image's split and label file.
#[derive(Debug, Clone)]
struct ListedImage {
    split: Split,
    labels: Option<PathBuf>,
}

/// The images of all places with their labels. A place without any label file is an error, unless
/// that is wanted; test images without labels, as contests have them, are left out.
fn labelled_images(
    folder: &Path,
    yaml: &DataYaml,
    options: &ImportOptions,
    problems: &mut Vec<Problem>,
) -> Result<BTreeMap<PathBuf, ListedImage>> {
    let mut images: BTreeMap<PathBuf, ListedImage> = BTreeMap::new();
    for (split, place) in &yaml.places {
        let PlaceImages {
            images: found,
            skipped: others,
            missing,
        } = images_at(folder, yaml.path.as_deref(), place)?;
        problems.extend(others.iter().map(|path| skipped(folder, path)));
        problems.extend(
            missing
                .into_iter()
                .map(|(subject, reason)| Problem { subject, reason }),
        );
        let labels: Vec<Option<PathBuf>> = found
            .par_iter()
            .map(|image| label_places(image).into_iter().find(|path| path.exists()))
            .collect();
        let is_labelled = labels.iter().any(Option::is_some);
        if !found.is_empty() && !is_labelled && !options.background {
            let looked = folders_looked_in(&found);
            if *split == Split::Test {
                problems.push(Problem {
                    subject: format!("{} images of {place}", found.len()),
                    reason: format!("have no label files in {looked}"),
                });
                continue;
            }
            return Err(Error::dataset(
                folder,
                format!(
                    "has no label file for any of the {} images of {place}: looked in {looked}",
                    found.len()
                ),
                "put the labels there, one .txt an image of its name; or say --background if there \
                 is nothing in these images",
            ));
        }
        for (image, labels) in found.into_iter().zip(labels) {
            let split = *split;
            // An image in several splits is learnt from: it can judge nothing.
            images.entry(image).or_insert(ListedImage { split, labels });
        }
    }
    Ok(images)
}

/// The folders in which labels of these images were looked for.
fn folders_looked_in(images: &[PathBuf]) -> String {
    const SHOWN: usize = 4;
    let places = images.iter().flat_map(|image| label_places(image));
    let folders: BTreeSet<PathBuf> = places
        .filter_map(|path| path.parent().map(Path::to_path_buf))
        .collect();
    let shown = folders.iter().take(SHOWN);
    let mut shown: Vec<String> = shown.map(|path| path.display().to_string()).collect();
    if folders.len() > SHOWN {
        shown.push(format!("{} more", folders.len() - SHOWN));
    }
    shown.join(" and ")
}

/// The square that was cut off at one border of the image, as YOLO's boxes are: as long as its other
/// side. Cut off at several borders, it stays as it is: nobody knows how much is missing.
fn whole_square(area: &PixelBox, [width, height]: [u32; 2]) -> PixelBox {
    let side = area.width().max(area.height());
    let [width, height] = [width, height].map(f64::from);
    let cut = [
        area.x_min <= 0.0,
        area.x_max >= width,
        area.y_min <= 0.0,
        area.y_max >= height,
    ];
    let mut whole = *area;
    match cut {
        [true, false, false, false] => whole.x_min = area.x_max - side,
        [false, true, false, false] => whole.x_max = area.x_min + side,
        [false, false, true, false] => whole.y_min = area.y_max - side,
        [false, false, false, true] => whole.y_max = area.y_min + side,
        _ => {}
    }
    whole
}

/// What images are read with.
struct Reader<'a> {
    kind: BoxKind,
    shape: LineShape,
    names: &'a BTreeMap<u32, String>,
    classes: &'a ClassMap,
}

/// An image, and lesser things that were left out of it.
struct Read {
    image: HeapImage,
    problems: Vec<Problem>,
}

impl Reader<'_> {
    fn read(&self, path: &Path, name: &str, listed: &ListedImage) -> Result<Read, String> {
        let size = copy::dimensions(path).map_err(|error| error.to_string())?;
        let text = match &listed.labels {
            Some(path) => files::read_text(path).map_err(|error| error.to_string())?,
            None => String::new(),
        };
        let mut objects = Vec::new();
        let mut left_out: BTreeSet<&str> = BTreeSet::new();
        for (index, line) in text.lines().enumerate() {
            if line.trim().is_empty() {
                continue;
            }
            let parsed = self.object(line, size).map_err(|reason| {
                let file = listed.labels.as_deref().and_then(Path::file_name);
                let file = file.unwrap_or_default().to_string_lossy();
                format!("{file} line {}: {reason}", index + 1)
            })?;
            objects.extend(parsed.0);
            left_out.extend(parsed.1);
        }
        let problem = |reason: &str| Problem {
            subject: name.to_owned(),
            reason: reason.to_owned(),
        };
        Ok(Read {
            problems: left_out.into_iter().map(problem).collect(),
            image: HeapImage {
                path: path.to_path_buf(),
                name: name.to_owned(),
                size,
                split: Some(listed.split),
                row: None,
                objects,
                stored: false,
            },
        })
    }

    /// An object of a line, and what was left out of it.
    fn object(
        &self,
        line: &str,
        size: [u32; 2],
    ) -> Result<(Option<HeapObject>, Option<&'static str>), String> {
        let (label, has_confidence) = match YoloLabel::parse(line, self.shape, size)? {
            Line::Object(label, has_confidence) => (label, has_confidence),
            Line::Nothing(reason) => return Ok((None, Some(reason))),
        };
        let name = self.names.get(&label.class);
        let name = name.ok_or_else(|| format!("class {} has no name", label.class))?;
        let object = self.classes.index_of(name).map(|class| HeapObject {
            class,
            box_pixel: match self.kind {
                BoxKind::Tight => label.box_pixel,
                BoxKind::Sphere => whole_square(&label.box_pixel, size),
            },
            distance_m: label.distance_m,
            ignored: false,
            id: None,
            center_pixel: None,
            visible: None,
        });
        Ok((object, has_confidence.then_some(CONFIDENCE)))
    }
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
