//! KITTI in.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::super::copy;
use super::super::draft::{Draft, DraftFrame, stamps};
use super::super::importer::Importer;
use super::super::options::ImportOptions;
use super::super::vehicle::{self, Sighting};
use super::super::{ClassMap, image_files};
use super::calib::Calibration;
use super::objects::{DONT_CARE, Object};
use super::single::{LeftImage, Single};
use crate::dataset::{BoxKind, Label, Problem, Split};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{Cuboid, StereoRig};

/// A frame as its files say it.
pub(super) struct Found {
    pub name: String,
    pub images: [PathBuf; 2],
    pub sizes: [[u32; 2]; 2],
    pub calibration: Calibration,
    pub objects: Vec<Object>,
    /// Boxes in the right image by the object's number.
    pub right: Vec<Option<Object>>,
    /// The objects' numbers where the source has them.
    pub ids: Option<Vec<u32>>,
    /// The number of its sequence.
    pub scene: Option<u32>,
}

/// KITTI's object detection folder.
pub(in super::super) struct Objects;

impl Importer for Objects {
    fn word(&self) -> &'static str {
        "kitti"
    }

    fn name(&self) -> &'static str {
        "KITTI's objects"
    }

    fn layout(&self) -> &'static str {
        "training/image_2/000000.png, image_3, calib, label_2/000000.txt"
    }

    fn matches(&self, source: &Path) -> bool {
        training_folder(source).is_ok_and(|training| training.join("label_2").is_dir())
    }

    fn read(
        &self,
        source: &Path,
        classes: Option<&ClassMap>,
        options: &ImportOptions,
    ) -> Result<Draft> {
        let training = training_folder(source)?;
        let splits = image_sets(&training)?;
        let classes = wanted_classes(classes);
        let mut problems = Vec::new();
        let left_images = image_files(&training.join("image_2"), &mut problems)?;
        let missing = ["image_3", "calib"]
            .into_iter()
            .find(|folder| !training.join(folder).is_dir());
        if let Some(missing) = missing {
            let reason = format!("there is no folder {missing}");
            let single = Single {
                reason,
                splits,
                classes,
                options,
            };
            return single.draft(source, left_only(&training, left_images), problems);
        }
        let right_images = image_files(&training.join("image_3"), &mut problems)?;
        let outcomes: Vec<Result<Found, Problem>> = left_images
            .par_iter()
            .map(|(name, left)| {
                let right = right_images.get(name).cloned();
                right
                    .ok_or_else(|| "has no image in image_3".to_owned())
                    .and_then(|right| read_frame(&training, name, [left.clone(), right]))
                    .map_err(|reason| Problem {
                        subject: name.clone(),
                        reason,
                    })
            })
            .collect();
        let mut found = Vec::new();
        for outcome in outcomes {
            match outcome {
                Ok(frame) => found.push(frame),
                Err(problem) => problems.push(problem),
            }
        }
        let mut objects = found
            .iter()
            .flat_map(|frame| &frame.objects)
            .filter(|object| classes.index_of(&object.class).is_some())
            .peekable();
        if objects.peek().is_some() && objects.all(|object| object.cuboid.is_none()) {
            let reason = "no label says where its object is in space".to_owned();
            let single = Single {
                reason,
                splits,
                classes,
                options,
            };
            // They are all read again, and named again.
            return single.draft(source, left_only(&training, left_images), Vec::new());
        }
        stereo_draft(source, found, &classes, options, &splits, problems)
    }
}

/// The left images with their labels.
fn left_only(training: &Path, images: BTreeMap<String, PathBuf>) -> Vec<LeftImage> {
    let of = |(name, path): (String, PathBuf)| LeftImage {
        objects: read_objects(training, "label_2", &name),
        name,
        path,
        scene: None,
    };
    images.into_iter().map(of).collect()
}

/// The wanted classes, or all cars as one.
pub(in super::super) fn wanted_classes(classes: Option<&ClassMap>) -> ClassMap {
    classes
        .cloned()
        .unwrap_or_else(|| ClassMap::merged("car", &["Car", "Van", "Truck"]))
}

/// A dataset of the pairs of one rig.
pub(super) fn stereo_draft(
    source: &Path,
    found: Vec<Found>,
    classes: &ClassMap,
    options: &ImportOptions,
    splits: &BTreeMap<String, Split>,
    mut problems: Vec<Problem>,
) -> Result<Draft> {
    let (found, size) = of_one_rig(found, options, &mut problems)?;
    let Some(first) = found.first() else {
        let reason = if problems.is_empty() {
            "there are no images".to_owned()
        } else {
            Problem::summary(&problems)
        };
        return Err(Error::dataset(
            source,
            format!("gives no usable frame: {reason}"),
            "repair what is named, or check that it is KITTI's folder of objects or tracks",
        ));
    };
    let rig = first.calibration.rig(size)?;
    let stamps = stamps(&found.iter().map(|f| f.name.clone()).collect::<Vec<_>>());
    let sized = found.iter().flat_map(|frame| &frame.objects);
    let has_spheres = sized
        .filter_map(|object| object.cuboid)
        .any(|cuboid| cuboid.height_m > 0.0);
    let frames = found
        .into_iter()
        .zip(stamps)
        .map(|(found, stamp)| draft(found, stamp, &rig, classes, options, splits))
        .collect();
    let kinds = if has_spheres {
        vec![BoxKind::Sphere, BoxKind::Tight]
    } else {
        vec![BoxKind::Tight]
    };
    let mut draft = Draft {
        program: "twinsight import kitti",
        source: source.to_path_buf(),
        classes: classes.names(),
        kinds,
        rig,
        stereo: true,
        frames,
        problems,
        unlabelled: 0,
    };
    draft.keep_kinds();
    Ok(draft)
}

fn training_folder(source: &Path) -> Result<PathBuf> {
    [source.join("training"), source.to_path_buf()]
        .into_iter()
        .find(|folder| folder.join("image_2").is_dir())
        .ok_or_else(|| {
            Error::dataset(
                source,
                "has no folder training/image_2",
                "give the folder of KITTI's object detection set that holds `training`",
            )
        })
}

fn read_frame(training: &Path, name: &str, images: [PathBuf; 2]) -> Result<Found, String> {
    let calibration = Calibration::read(&training.join("calib").join(format!("{name}.txt")))
        .map_err(|reason| format!("calibration: {reason}"))?;
    let objects = read_objects(training, "label_2", name)?;
    let right_path = training.join("label_3").join(format!("{name}.txt"));
    let right = if right_path.exists() {
        read_objects(training, "label_3", name)?
    } else {
        Vec::new()
    };
    let size = |path: &Path| copy::dimensions(path).map_err(|error| error.to_string());
    let sizes = [size(&images[0])?, size(&images[1])?];
    // Line by line the same object: it has the same class and place.
    let same = |(left, right): (&Object, &Object)| {
        left.class == right.class && left.cuboid == right.cuboid && left.cuboid.is_some()
    };
    let right = (0..objects.len())
        .map(|i| {
            right
                .get(i)
                .filter(|right| same((&objects[i], right)))
                .cloned()
        })
        .collect();
    Ok(Found {
        name: name.to_owned(),
        images,
        sizes,
        calibration,
        objects,
        right,
        ids: None,
        scene: None,
    })
}

pub(super) fn read_objects(
    training: &Path,
    folder: &str,
    name: &str,
) -> Result<Vec<Object>, String> {
    let path = training.join(folder).join(format!("{name}.txt"));
    let text = files::read_text(&path).map_err(|error| error.to_string())?;
    Object::parse_file(&text, &format!("{folder}/{name}.txt"))
}

/// The frames of one calibration, and the size that holds all their images.
fn of_one_rig(
    found: Vec<Found>,
    options: &ImportOptions,
    problems: &mut Vec<Problem>,
) -> Result<(Vec<Found>, [u32; 2])> {
    let mut rigs: BTreeMap<Vec<i64>, Vec<Found>> = BTreeMap::new();
    for frame in found {
        rigs.entry(frame.calibration.key()).or_default().push(frame);
    }
    let mut rigs: Vec<Vec<Found>> = rigs.into_values().collect();
    rigs.sort_by_key(|frames| std::cmp::Reverse(frames.len()));
    let count = rigs.len();
    if options.rig == 0 || (options.rig > count && count > 0) {
        return Err(Error::value(
            format!("rig {}", options.rig),
            format!("the frames have {count} rigs"),
            format!("give a number from 1 to {count}"),
        ));
    }
    let mut kept = Vec::new();
    for (number, frames) in (1..).zip(rigs) {
        if number == options.rig {
            kept = frames;
            continue;
        }
        problems.extend(frames.into_iter().map(|frame| Problem {
            subject: frame.name,
            reason: format!(
                "has another rig, focal length {:.2} px and baseline {:.4} m; import it into a \
                 dataset of its own with --rig {number}",
                frame.calibration.left.focal_x_px, frame.calibration.baseline_m
            ),
        }));
    }
    let sizes = || kept.iter().flat_map(|frame| frame.sizes);
    let largest = |i: usize| sizes().map(|size| size[i]).max().unwrap_or(0);
    let size = [largest(0), largest(1)];
    Ok((kept, size))
}

fn draft(
    found: Found,
    stamp: u64,
    rig: &StereoRig,
    classes: &ClassMap,
    options: &ImportOptions,
    splits: &BTreeMap<String, Split>,
) -> DraftFrame {
    let mut sides = [Vec::new(), Vec::new()];
    let mut judged: Vec<Cuboid> = Vec::new();
    let mut rows = Vec::new();
    let ids = found.ids.clone();
    let ids = ids.unwrap_or_else(|| (0..found.objects.len() as u32).collect());
    for (id, (object, right)) in ids.into_iter().zip(found.objects.iter().zip(&found.right)) {
        if object.class == DONT_CARE {
            sides[0].extend(region(object, id));
            continue;
        }
        let Some(class) = classes.index_of(&object.class) else {
            continue;
        };
        let Some(cuboid) = object.cuboid else {
            sides[0].extend(region(object, id));
            continue;
        };
        let cuboid_rig = cuboid.moved(found.calibration.rig_from_reference_m);
        let truncated = object.truncated.unwrap_or(0.0);
        let sighting = Sighting {
            id,
            class,
            ignored: object.occluded > options.most_occluded || truncated > options.most_truncated,
            visible: [(object.occluded == 0).then_some(1.0 - truncated), None],
            boxes: [
                Some(object.box_pixel),
                right.as_ref().map(|right| right.box_pixel),
            ],
        };
        if cuboid.height_m > 0.0 {
            rows.push(vehicle::object_row(id, &object.class, &cuboid_rig));
        }
        if !sighting.ignored {
            judged.push(cuboid_rig);
        }
        let labels = vehicle::labels(rig, &cuboid_rig, &sighting);
        for (side, labels) in sides.iter_mut().zip(labels) {
            side.extend(labels);
        }
    }
    let split = splits.get(&found.name).copied();
    let mut frame = DraftFrame::new(found.name, stamp, found.images.to_vec(), sides.to_vec());
    frame.split = split;
    frame.row.scene = found.scene;
    frame.objects = rows;
    vehicle::describe(&mut frame, &judged);
    frame
}

/// A region in which nothing was labelled, or a vehicle without a box in space: ignored, whatever
/// kind of box is learnt.
fn region(object: &Object, id: u32) -> [Label; 2] {
    [BoxKind::Sphere, BoxKind::Tight].map(|kind| Label {
        id,
        class: 0,
        box_pixel: object.box_pixel,
        center_pixel: object.box_pixel.center(),
        distance_m: None,
        kind,
        visible: None,
        ignored: true,
    })
}

/// Which frames the lists in `ImageSets` give to which split. The folder stands beside `training`,
/// whichever of the two was given, or in it.
fn image_sets(training: &Path) -> Result<BTreeMap<String, Split>> {
    let training = training
        .canonicalize()
        .map_err(Error::io("read", training))?;
    let lists = [training.parent(), Some(&*training)]
        .into_iter()
        .flatten()
        .map(|folder| folder.join("ImageSets"))
        .find(|lists| lists.is_dir());
    let mut splits = BTreeMap::new();
    let Some(lists) = lists else {
        return Ok(splits);
    };
    for split in Split::ALL {
        let path = lists.join(format!("{split}.txt"));
        if path.exists() {
            let text = fs::read_to_string(&path).map_err(Error::io("read", &path))?;
            let names = text
                .split_whitespace()
                .map(|name| (name.to_owned(), *split));
            splits.extend(names);
        }
    }
    Ok(splits)
}
