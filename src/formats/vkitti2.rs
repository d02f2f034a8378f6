//! Virtual KITTI 2: rendered streets in several weathers and times of day.
//!
//! ```text
//! <folder>/Scene01/clone/frames/rgb/Camera_0/rgb_00000.jpg   left image; Camera_1 is the right one
//!                        intrinsic.txt extrinsic.txt          both cameras, frame by frame
//!                        bbox.txt pose.txt info.txt           boxes in the images and in space
//! ```
//!
//! Pixels are numbered from 0 and boxes include their last pixel, so a box of this crate ends one
//! pixel later and a principal point lies half a pixel further.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::copy;
use super::draft::{Draft, DraftFrame};
use super::importer::Importer;
use super::kitti::wanted_classes;
use super::number::{finite, whole};
use super::options::ImportOptions;
use super::vehicle::{self, Sighting};
use super::{ClassMap, image_files};
use crate::dataset::{BoxKind, Problem, Side};
use crate::error::{Error, Result};
use crate::files;
use crate::geometry::{Cuboid, Intrinsics, PixelBox, RigSettings, StereoRig};

/// From Virtual KITTI's principal point to this crate's.
const HALF_PIXEL: f64 = 0.5;

/// Virtual KITTI 2. The scenes' numbers are kept, so splits keep scenes apart.
pub(super) struct VirtualKitti;

impl Importer for VirtualKitti {
    fn word(&self) -> &'static str {
        "vkitti2"
    }

    fn name(&self) -> &'static str {
        "Virtual KITTI 2"
    }

    fn layout(&self) -> &'static str {
        "Scene01/clone/frames/rgb/Camera_0/rgb_00000.jpg, bbox.txt, pose.txt, info.txt"
    }

    fn matches(&self, source: &Path) -> bool {
        source.is_dir() && scenes(source).is_ok()
    }

    fn read(
        &self,
        source: &Path,
        classes: Option<&ClassMap>,
        options: &ImportOptions,
    ) -> Result<Draft> {
        let classes = wanted_classes(classes);
        let mut read = Read {
            options,
            classes: &classes,
            rig: None,
            frames: Vec::new(),
            problems: Vec::new(),
        };
        for (scene, folder) in scenes(source)? {
            for (variant, folder) in folders(&folder)? {
                let wanted = options.variants.is_empty() || options.variants.contains(&variant);
                if wanted && let Err(reason) = read.variant(scene, &variant, &folder) {
                    read.problems.push(Problem {
                        subject: format!("Scene{scene:02}/{variant}"),
                        reason,
                    });
                }
            }
        }
        let Read {
            rig,
            frames,
            problems,
            ..
        } = read;
        let Some(rig) = rig else {
            let reason = if problems.is_empty() {
                "no variant of a scene was found".to_owned()
            } else {
                Problem::summary(&problems)
            };
            return Err(Error::dataset(
                source,
                format!("gives no usable frame: {reason}"),
                "unpack both vkitti_2.0.3_rgb and vkitti_2.0.3_textgt into it",
            ));
        };
        Ok(Draft {
            program: "twinsight import vkitti2",
            source: source.to_path_buf(),
            classes: classes.names(),
            kinds: vec![BoxKind::Sphere, BoxKind::Tight],
            rig,
            stereo: true,
            frames,
            problems,
            unlabelled: 0,
        })
    }
}

/// The scenes by number.
fn scenes(source: &Path) -> Result<BTreeMap<u32, PathBuf>> {
    let found: BTreeMap<u32, PathBuf> = folders(source)?
        .into_iter()
        .filter_map(|(name, path)| Some((name.strip_prefix("Scene")?.parse().ok()?, path)))
        .collect();
    if found.is_empty() {
        return Err(Error::dataset(
            source,
            "has no folder Scene01 or alike",
            "give the folder that holds the scenes of Virtual KITTI 2",
        ));
    }
    Ok(found)
}

fn folders(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let entries = fs::read_dir(folder).map_err(Error::io("read", folder))?;
    let mut found = BTreeMap::new();
    for entry in entries {
        let path = entry.map_err(Error::io("read", folder))?.path();
        if path.is_dir() {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            found.insert(name.into_owned(), path.clone());
        }
    }
    Ok(found)
}

/// What has been read so far.
struct Read<'a> {
    options: &'a ImportOptions,
    classes: &'a ClassMap,
    rig: Option<StereoRig>,
    frames: Vec<DraftFrame>,
    problems: Vec<Problem>,
}

/// One vehicle in one frame and camera: frame, camera, track.
type Key = (u32, u32, u32);

impl Read<'_> {
    /// Reads one variant of a scene; the reason against it in words.
    fn variant(&mut self, scene: u32, variant: &str, folder: &Path) -> Result<(), String> {
        let mut images = |camera: u32| {
            let folder = folder.join(format!("frames/rgb/Camera_{camera}"));
            image_files(&folder, &mut self.problems).map_err(|error| error.to_string())
        };
        let [left, right] = [images(0)?, images(1)?];
        let rig = Self::variant_rig(folder, left.values().next())?;
        let known = *self.rig.get_or_insert(rig);
        if known != rig {
            return Err("has other cameras than the scenes before it".to_owned());
        }
        let classes = track_classes(folder, self.classes)?;
        let boxes = boxes(folder)?;
        let mut cuboids = cuboids(folder)?;
        for (name, left) in &left {
            let label = format!("Scene{scene:02}/{variant}/{name}");
            let number = name
                .strip_prefix("rgb_")
                .and_then(|digits| digits.parse().ok());
            let (Some(right), Some(number)) = (right.get(name), number) else {
                self.problems.push(Problem {
                    subject: label,
                    reason: match number {
                        Some(_) => "has no right image",
                        None => "is not called rgb_ and a number",
                    }
                    .to_owned(),
                });
                continue;
            };
            let mut sides = [Vec::new(), Vec::new()];
            let mut judged = Vec::new();
            let mut rows = Vec::new();
            for (track, class) in &classes {
                let seen = [0, 1].map(|camera| boxes.get(&(number, camera, *track)));
                // A vehicle is where the left camera says; without it, the right one's word.
                let half_m = rig.baseline_m / 2.0;
                let cuboid = [(0, -half_m), (1, half_m)]
                    .into_iter()
                    .find_map(|(camera, x_m)| {
                        let cuboid = cuboids.remove(&(number, camera, *track))?;
                        Some(cuboid.moved([x_m, 0.0, 0.0]))
                    });
                let (Some(cuboid), [Some(_), _] | [_, Some(_)]) = (cuboid, seen) else {
                    continue;
                };
                let visible = seen.map(|seen| seen.map(|(_, visible)| *visible));
                let least = visible.iter().flatten().copied().fold(1.0, f64::min);
                let sighting = Sighting {
                    id: *track,
                    class: class.1,
                    ignored: least < self.options.least_visible,
                    visible,
                    boxes: seen.map(|seen| seen.map(|(area, _)| *area)),
                };
                rows.push(vehicle::object_row(*track, &class.0, &cuboid));
                if !sighting.ignored {
                    judged.push(cuboid);
                }
                let labels = vehicle::labels(&rig, &cuboid, &sighting);
                for ((side, labels), seen) in sides.iter_mut().zip(labels).zip(seen) {
                    // A camera without a box does not see the vehicle.
                    side.extend(labels.into_iter().filter(|_| seen.is_some()));
                }
            }
            let stamp = self.frames.len() as u64 + 1;
            let images = vec![left.clone(), right.clone()];
            let mut frame = DraftFrame::new(label, stamp, images, sides.to_vec());
            frame.objects = rows;
            frame.row.scene = Some(scene);
            frame.row.sun = ["morning", "sunset"]
                .contains(&variant)
                .then(|| variant.to_owned());
            vehicle::describe(&mut frame, &judged);
            self.frames.push(frame);
        }
        Ok(())
    }

    /// The rig of a variant's first frame, with the size of its first image.
    fn variant_rig(folder: &Path, image: Option<&PathBuf>) -> Result<StereoRig, String> {
        let image = image.ok_or("has no images of Camera_0")?;
        let [width, height] = copy::dimensions(image).map_err(|error| error.to_string())?;
        let intrinsics = Table::read(&folder.join("intrinsic.txt"))?;
        let [fx, fy, cx, cy] = intrinsics.columns(["K[0,0]", "K[1,1]", "K[0,2]", "K[1,2]"])?;
        let extrinsics = Table::read(&folder.join("extrinsic.txt"))?;
        let [t1] = extrinsics.columns(["t1"])?;
        let of_camera = |camera: Side| {
            let number = (camera as usize).to_string();
            let row = intrinsics.row_of_camera(&number)?;
            let value = |column| row.number(column);
            let camera = Intrinsics {
                focal_x_px: value(fx)?,
                focal_y_px: value(fy)?,
                center_x_px: value(cx)? + HALF_PIXEL,
                center_y_px: value(cy)? + HALF_PIXEL,
            };
            Ok::<_, String>((camera, extrinsics.row_of_camera(&number)?.number(t1)?))
        };
        let ((left, left_m), (right, right_m)) = (of_camera(Side::Left)?, of_camera(Side::Right)?);
        let settings = RigSettings {
            width,
            height,
            // Extrinsics are printed with float32's digits; 0.1 mm is less than they hold.
            baseline_m: ((left_m - right_m) * 1e6).round() / 1e6,
            hfov_deg: None,
            left: Some(left),
            right: Some(right),
        };
        settings
            .try_into()
            .map_err(|error: Error| error.to_string())
    }
}

/// The foreign class of each track and ours.
fn track_classes(
    folder: &Path,
    classes: &ClassMap,
) -> Result<BTreeMap<u32, (String, u32)>, String> {
    let table = Table::read(&folder.join("info.txt"))?;
    let [track, label] = table.columns(["trackID", "label"])?;
    let mut found = BTreeMap::new();
    for row in table.rows() {
        let name = row.text(label)?;
        if let Some(class) = classes.index_of(name) {
            found.insert(row.whole(track)?, (name.to_owned(), class));
        }
    }
    Ok(found)
}

/// Box and visible fraction.
fn boxes(folder: &Path) -> Result<BTreeMap<Key, (PixelBox, f64)>, String> {
    let table = Table::read(&folder.join("bbox.txt"))?;
    let [
        frame,
        camera,
        track,
        left,
        right,
        top,
        bottom,
        truncation,
        occupancy,
    ] = table.columns([
        "frame",
        "cameraID",
        "trackID",
        "left",
        "right",
        "top",
        "bottom",
        "truncation_ratio",
        "occupancy_ratio",
    ])?;
    let mut found = BTreeMap::new();
    for row in table.rows() {
        let area = PixelBox::new(
            row.number(left)?,
            row.number(top)?,
            row.number(right)? + 1.0,
            row.number(bottom)? + 1.0,
        );
        if !area.is_valid() {
            return Err(row.error("the box is inverted"));
        }
        let visible = (1.0 - row.number(truncation)?) * row.number(occupancy)?;
        let key = (row.whole(frame)?, row.whole(camera)?, row.whole(track)?);
        found.insert(key, (area, visible.clamp(0.0, 1.0)));
    }
    Ok(found)
}

/// Boxes in space, axes of the camera in the key.
fn cuboids(folder: &Path) -> Result<BTreeMap<Key, Cuboid>, String> {
    let table = Table::read(&folder.join("pose.txt"))?;
    let [frame, camera, track, width, height, length, x, y, z, yaw] = table.columns([
        "frame",
        "cameraID",
        "trackID",
        "width",
        "height",
        "length",
        "camera_space_X",
        "camera_space_Y",
        "camera_space_Z",
        "rotation_camera_space_y",
    ])?;
    let mut found = BTreeMap::new();
    for row in table.rows() {
        let [width_m, height_m, length_m] =
            [row.number(width)?, row.number(height)?, row.number(length)?];
        if width_m <= 0.0 || height_m <= 0.0 || length_m <= 0.0 {
            return Err(row.error("a size is not positive"));
        }
        let cuboid = Cuboid {
            // The place given is the centre of the bottom, as KITTI's.
            center_camera: [
                row.number(x)?,
                row.number(y)? - height_m / 2.0,
                row.number(z)?,
            ],
            length_m,
            width_m,
            height_m,
            yaw_rad: row.number(yaw)?,
        };
        let key = (row.whole(frame)?, row.whole(camera)?, row.whole(track)?);
        found.insert(key, cuboid);
    }
    Ok(found)
}

/// A text file of columns that blanks divide, with a header.
struct Table {
    name: String,
    header: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// One line of a table.
struct Row<'a> {
    table: &'a Table,
    index: usize,
}

impl Table {
    fn read(path: &Path) -> Result<Self, String> {
        let text = files::read_text(path).map_err(|error| error.to_string())?;
        let words = |line: &str| line.split_whitespace().map(str::to_owned).collect();
        let mut lines = text.lines().filter(|line| !line.trim().is_empty());
        let header = lines.next().map(words).unwrap_or_default();
        Ok(Self {
            name: path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            header,
            rows: lines.map(words).collect(),
        })
    }

    fn columns<const N: usize>(&self, names: [&str; N]) -> Result<[usize; N], String> {
        let mut columns = [0; N];
        for (column, name) in columns.iter_mut().zip(names) {
            let found = self.header.iter().position(|word| word == name);
            *column = found.ok_or_else(|| format!("{} has no column {name}", self.name))?;
        }
        Ok(columns)
    }

    fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.rows.len()).map(|index| Row { table: self, index })
    }

    fn row_of_camera(&self, camera: &str) -> Result<Row<'_>, String> {
        let [column] = self.columns(["cameraID"])?;
        self.rows()
            .find(|row| row.text(column) == Ok(camera))
            .ok_or_else(|| format!("{} has no line of camera {camera}", self.name))
    }
}

impl Row<'_> {
    fn error(&self, reason: &str) -> String {
        // The header is line 1.
        format!("{} line {}: {reason}", self.table.name, self.index + 2)
    }

    fn text(&self, column: usize) -> Result<&str, String> {
        let word = self.table.rows[self.index].get(column);
        word.map(String::as_str)
            .ok_or_else(|| self.error(&format!("has no {}", self.table.header[column])))
    }

    fn number(&self, column: usize) -> Result<f64, String> {
        finite(self.text(column)?, &self.table.header[column]).map_err(|why| self.error(&why))
    }

    fn whole(&self, column: usize) -> Result<u32, String> {
        whole(self.text(column)?, &self.table.header[column]).map_err(|why| self.error(&why))
    }
}
