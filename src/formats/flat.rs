//! Datasets that are a heap of images with boxes, as YOLO's and COCO's: sorted into stereo pairs
//! where the names say so, single images otherwise.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use super::copy::scale_to_fit;
use super::draft::{Draft, DraftFrame, stamps};
use super::options::ImportOptions;
use crate::dataset::{BoxKind, DatasetInfo, FrameRow, Label, Problem, Side, Split};
use crate::detector::Detection;
use crate::error::{Error, Result};
use crate::geometry::{PixelBox, StereoRig};
use crate::pairing::{PairingConfig, pair};

/// Distances of one vehicle in the two files of a pair agree to their last decimal.
const SAME_DISTANCE_M: f64 = 1e-3;

/// Single images on a common canvas may cost this many times their own pixels.
const MOST_WASTE: u64 = 4;

/// An image with its objects.
#[derive(Debug, Clone)]
pub(super) struct HeapImage {
    /// The image file.
    pub path: PathBuf,
    /// The same inside the dataset, with `/`.
    pub name: String,
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// The split that the source gives it.
    pub split: Option<Split>,
    /// What the source knows of the frame, if it was written by this crate.
    pub row: Option<FrameRow>,
    /// What is in it.
    pub objects: Vec<HeapObject>,
    /// Whether boxes count in its pixels as they are stored, not as they are shown.
    pub stored: bool,
}

/// An object in an image.
#[derive(Debug, Clone)]
pub(super) struct HeapObject {
    /// Our class.
    pub class: u32,
    /// Pixels.
    pub box_pixel: PixelBox,
    /// Metres.
    pub distance_m: Option<f64>,
    /// Neither learnt nor judged.
    pub ignored: bool,
    /// The same in both images, where the source says so.
    pub id: Option<u32>,
    /// Projected centre, pixels.
    pub center_pixel: Option<[f64; 2]>,
    /// Visible fraction.
    pub visible: Option<f64>,
}

/// What a format has read.
pub(super) struct Heap {
    pub program: &'static str,
    pub source: PathBuf,
    pub classes: Vec<String>,
    pub kind: BoxKind,
    /// The rig that the source names.
    pub rig: Option<StereoRig>,
    pub images: Vec<HeapImage>,
    pub problems: Vec<Problem>,
    /// Images that nobody labelled.
    pub unlabelled: usize,
}

impl Heap {
    /// Sorts the images into frames.
    pub fn into_draft(self, options: &ImportOptions) -> Result<Draft> {
        let is_right = |image: &HeapImage| matches!(side_of(&image.name), Some((Side::Right, _)));
        if !options.single && self.images.iter().any(is_right) {
            self.pairs(options)
        } else {
            self.single(options)
        }
    }

    fn draft(self, rig: StereoRig, stereo: bool, frames: Vec<DraftFrame>) -> Draft {
        Draft {
            program: self.program,
            source: self.source,
            classes: self.classes,
            kinds: vec![self.kind],
            rig,
            stereo,
            frames,
            problems: self.problems,
            unlabelled: self.unlabelled,
        }
    }

    fn single(mut self, options: &ImportOptions) -> Result<Draft> {
        let canvas = self.canvas(options)?;
        let rig = DatasetInfo::single_image_rig(canvas[0], canvas[1])?;
        let images = std::mem::take(&mut self.images);
        let names: Vec<String> = images.iter().map(|image| stem(&image.name)).collect();
        let kind = self.kind;
        let frames = images
            .into_iter()
            .zip(stamps(&names))
            .map(|(image, stamp)| {
                let scale = scale_to_fit(image.size, canvas);
                let labels = (0..)
                    .zip(&image.objects)
                    .map(|(id, object)| label(object, object.id.unwrap_or(id), kind, scale))
                    .collect();
                frame(image.name.clone(), stamp, vec![image], vec![labels])
            })
            .collect();
        Ok(self.draft(rig, false, frames))
    }

    fn canvas(&self, options: &ImportOptions) -> Result<[u32; 2]> {
        if let Some(canvas) = options.canvas {
            return Ok(canvas);
        }
        let side = |i: usize| self.images.iter().map(|image| image.size[i]).max();
        let canvas = [0, 1].map(|i| side(i).unwrap_or(2).max(2));
        let area = |[width, height]: [u32; 2]| u64::from(width) * u64::from(height);
        let own: u64 = self.images.iter().map(|image| area(image.size)).sum();
        if area(canvas) * self.images.len() as u64 > MOST_WASTE * own.max(1) {
            return Err(Error::value(
                format!("canvas of {}x{} pixels", canvas[0], canvas[1]),
                "would be mostly empty: few images are as large",
                "give --size 640x640 or alike: larger images are shrunk to fit",
            ));
        }
        Ok(canvas)
    }

    fn pairs(mut self, options: &ImportOptions) -> Result<Draft> {
        let mut pairs: BTreeMap<String, [Option<HeapImage>; 2]> = BTreeMap::new();
        for image in std::mem::take(&mut self.images) {
            match side_of(&image.name) {
                Some((side, key)) => pairs.entry(key).or_default()[side as usize] = Some(image),
                None => self.problems.push(Problem {
                    subject: image.name,
                    reason: "is neither a left nor a right image".to_owned(),
                }),
            }
        }
        let mut whole = Vec::new();
        for (key, pair) in pairs {
            match pair {
                [Some(left), Some(right)] => whole.push((key, left, right)),
                [Some(image), None] | [None, Some(image)] => self.problems.push(Problem {
                    subject: image.name,
                    reason: "has no partner in the other image of the pair".to_owned(),
                }),
                [None, None] => {}
            }
        }
        let rig = self.pair_rig(options, &whole)?;
        let size = [rig.left.width, rig.left.height];
        whole.retain(|(_, left, right)| {
            let odd = [left, right].into_iter().find(|image| image.size != size);
            if let Some(image) = odd {
                self.problems.push(Problem {
                    subject: image.name.clone(),
                    reason: format!(
                        "has {}x{} pixels and the rig {}x{}",
                        image.size[0], image.size[1], size[0], size[1]
                    ),
                });
            }
            odd.is_none()
        });
        let names: Vec<String> = whole.iter().map(|(key, _, _)| stem(key)).collect();
        let kind = self.kind;
        let frames = whole
            .into_iter()
            .zip(stamps(&names))
            .map(|((key, left, right), stamp)| {
                let ids = partners(&left.objects, &right.objects, &rig);
                let labels = [&left, &right].into_iter().zip(ids).map(|(image, ids)| {
                    let labelled = image.objects.iter().zip(ids);
                    labelled
                        .map(|(object, id)| label(object, id, kind, 1.0))
                        .collect()
                });
                let labels = labels.collect();
                frame(key, stamp, vec![left, right], labels)
            })
            .collect();
        Ok(self.draft(rig, true, frames))
    }

    fn pair_rig(
        &self,
        options: &ImportOptions,
        pairs: &[(String, HeapImage, HeapImage)],
    ) -> Result<StereoRig> {
        match (options.baseline_m, options.hfov_deg, self.rig) {
            (None, None, Some(rig)) => Ok(rig),
            (Some(baseline_m), Some(hfov_deg), _) => {
                let mut sizes: BTreeMap<[u32; 2], usize> = BTreeMap::new();
                for (_, left, _) in pairs {
                    *sizes.entry(left.size).or_default() += 1;
                }
                let common = sizes.iter().max_by_key(|(_, count)| **count);
                let [width, height] = common.map_or([2, 2], |(size, _)| *size);
                StereoRig::from_hfov(width, height, hfov_deg, baseline_m)
            }
            _ => Err(Error::dataset(
                &self.source,
                "has stereo pairs, and nothing says what cameras took them",
                "give --baseline-m and --hfov-deg, or --single to take every image by itself",
            )),
        }
    }
}

fn frame(name: String, stamp: u64, images: Vec<HeapImage>, labels: Vec<Vec<Label>>) -> DraftFrame {
    let split = images.first().and_then(|image| image.split);
    let row = images.first().and_then(|image| image.row.clone());
    let stored = images.first().is_some_and(|image| image.stored);
    let paths = images.into_iter().map(|image| image.path).collect();
    let mut frame = DraftFrame::new(name, stamp, paths, labels);
    frame.split = split;
    frame.stored = stored;
    if let Some(row) = row {
        frame.row = FrameRow { stamp, ..row };
    }
    frame
}

fn label(object: &HeapObject, id: u32, kind: BoxKind, scale: f64) -> Label {
    let area = object.box_pixel;
    let box_pixel = PixelBox::new(
        area.x_min * scale,
        area.y_min * scale,
        area.x_max * scale,
        area.y_max * scale,
    );
    Label {
        id,
        class: object.class,
        box_pixel,
        center_pixel: object
            .center_pixel
            .map_or_else(|| box_pixel.center(), |center| center.map(|v| v * scale)),
        distance_m: object.distance_m,
        kind,
        visible: object.visible,
        ignored: object.ignored,
    }
}

/// The vehicles' numbers in both images: those of the source where it has them; otherwise the same
/// number for what has the same class and distance, or else for what the geometry of the rig
/// brings together.
fn partners(left: &[HeapObject], right: &[HeapObject], rig: &StereoRig) -> [Vec<u32>; 2] {
    let own = |objects: &[HeapObject]| objects.iter().map(|o| o.id).collect::<Option<Vec<_>>>();
    if let (Some(left), Some(right)) = (own(left), own(right)) {
        return [left, right];
    }
    let left_ids: Vec<u32> = (0..left.len() as u32).collect();
    let mut right_ids: Vec<Option<u32>> = vec![None; right.len()];
    let same = |a: &HeapObject, b: &HeapObject| {
        let distances = a.distance_m.zip(b.distance_m);
        a.class == b.class && distances.is_some_and(|(a, b)| (a - b).abs() < SAME_DISTANCE_M)
    };
    let mut open = vec![true; left.len()];
    for (l, object) in left.iter().enumerate() {
        let alike: Vec<usize> = (0..right.len())
            .filter(|&r| same(object, &right[r]))
            .collect();
        let rivals = left.iter().filter(|other| same(other, object)).count();
        if let ([r], 1) = (&alike[..], rivals) {
            right_ids[*r] = Some(left_ids[l]);
            open[l] = false;
        }
    }
    let detection = |object: &HeapObject| Detection {
        box_pixel: object.box_pixel,
        score: 1.0,
        class: object.class as usize,
    };
    let open_left: Vec<usize> = (0..left.len()).filter(|&l| open[l]).collect();
    let open_right: Vec<usize> = (0..right.len())
        .filter(|&r| right_ids[r].is_none())
        .collect();
    let lefts: Vec<_> = open_left.iter().map(|&l| detection(&left[l])).collect();
    let rights: Vec<_> = open_right.iter().map(|&r| detection(&right[r])).collect();
    for (l, r, _) in pair(&lefts, &rights, rig, &PairingConfig::default()).pairs {
        let (l, r) = (open_left[l], open_right[r]);
        // Two known distances that differ are two vehicles.
        let differ = left[l]
            .distance_m
            .zip(right[r].distance_m)
            .is_some_and(|(a, b)| (a - b).abs() >= SAME_DISTANCE_M);
        if !differ {
            right_ids[r] = Some(left_ids[l]);
        }
    }
    let mut next = left.len() as u32;
    let right_ids = right_ids
        .into_iter()
        .map(|id| {
            id.unwrap_or_else(|| {
                next += 1;
                next - 1
            })
        })
        .collect();
    [left_ids, right_ids]
}

/// Which camera an image's name speaks of, and the name without that: `left_00042.png` as well as
/// `train/left/00042.png`.
fn side_of(name: &str) -> Option<(Side, String)> {
    let path = Path::new(name);
    let file = stem(name);
    let folder = path.parent().unwrap_or(Path::new(""));
    for side in Side::ALL {
        let word = side.word();
        let prefix = file
            .strip_prefix(word)
            .and_then(|rest| rest.strip_prefix('_'));
        let suffix = file
            .strip_suffix(word)
            .and_then(|rest| rest.strip_suffix('_'));
        if let Some(rest) = prefix.or(suffix) {
            return Some((side, folder.join(rest).to_string_lossy().into_owned()));
        }
        let is_side = |part: &Component<'_>| part.as_os_str().eq_ignore_ascii_case(word);
        if folder.components().any(|part| is_side(&part)) {
            let rest: PathBuf = folder.components().filter(|part| !is_side(part)).collect();
            return Some((side, rest.join(&file).to_string_lossy().into_owned()));
        }
    }
    None
}

/// A name without folders and ending.
fn stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_which_camera_took_an_image() {
        let key = |side, key: &str| Some((side, key.to_owned()));
        for (name, expected) in [
            ("train/left_00042.png", key(Side::Left, "train/00042")),
            ("train/right_00042.png", key(Side::Right, "train/00042")),
            ("train/00042_left.jpg", key(Side::Left, "train/00042")),
            ("left/train/a.png", key(Side::Left, "train/a")),
            ("train/Right/a.png", key(Side::Right, "train/a")),
            ("train/leftover.png", None),
        ] {
            assert_eq!(side_of(name), expected, "{name}");
        }
    }

    #[test]
    fn partners_have_the_same_distance_or_obey_the_rig() {
        let rig = StereoRig::from_hfov(640, 360, 90.0, 0.8).unwrap();
        let object = |x: f64, distance_m| HeapObject {
            class: 0,
            box_pixel: PixelBox::from_center([x, 180.0], 40.0, 30.0),
            distance_m,
            ignored: false,
            id: None,
            center_pixel: None,
            visible: None,
        };
        let left = [object(100.0, Some(25.6)), object(300.0, Some(12.8))];
        let right = [object(280.0, Some(12.8)), object(90.0, Some(25.6))];
        assert_eq!(partners(&left, &right, &rig), [vec![0, 1], vec![1, 0]]);
        let unknown = |objects: &[HeapObject]| {
            let without = objects.iter().map(|object| HeapObject {
                distance_m: None,
                ..object.clone()
            });
            without.collect::<Vec<_>>()
        };
        let mut rights = unknown(&right);
        rights.push(object(600.0, None));
        assert_eq!(
            partners(&unknown(&left), &rights, &rig),
            [vec![0, 1], vec![1, 0, 2]]
        );
    }
}
