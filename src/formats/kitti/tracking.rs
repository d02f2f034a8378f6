//! KITTI's tracking folder: sequences in folders of their own.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::super::draft::Draft;
use super::super::importer::Importer;
use super::super::number::whole;
use super::super::options::ImportOptions;
use super::super::{ClassMap, copy, image_files};
use super::calib::Calibration;
use super::import::{Found, stereo_draft, wanted_classes};
use super::objects::Object;
use super::single::{LeftImage, Single};
use crate::dataset::Problem;
use crate::error::{Error, Result};
use crate::files;
use crate::imaging::files_in;

/// KITTI's tracking folder. Its sequences become scenes, so splits keep them apart.
pub(in super::super) struct Tracking;

impl Importer for Tracking {
    fn word(&self) -> &'static str {
        "kitti"
    }

    fn name(&self) -> &'static str {
        "KITTI's tracks"
    }

    fn layout(&self) -> &'static str {
        "training/image_02/0000/000000.png, image_03, calib/0000.txt, label_02/0000.txt"
    }

    fn matches(&self, source: &Path) -> bool {
        training_folder(source).is_ok()
    }

    fn read(
        &self,
        source: &Path,
        classes: Option<&ClassMap>,
        options: &ImportOptions,
    ) -> Result<Draft> {
        let training = training_folder(source)?;
        let classes = wanted_classes(classes);
        let mut problems = Vec::new();
        let mut found = Vec::new();
        let mut left_only = Vec::new();
        let missing = ["image_03", "calib"]
            .into_iter()
            .find(|folder| !training.join(folder).is_dir());
        for (scene, folder) in (1..).zip(files_in(&training.join("image_02"))?.folders) {
            let name = folder.file_name().unwrap_or_default().to_string_lossy();
            let sequence = Sequence {
                training: &training,
                name: &name,
                scene,
            };
            let read = if missing.is_some() {
                let images = sequence.left_images(&folder, &mut problems);
                images.map(|images| left_only.extend(images))
            } else {
                let frames = sequence.read(&folder, &mut problems);
                frames.map(|frames| found.extend(frames))
            };
            if let Err(reason) = read {
                problems.push(Problem {
                    subject: format!("sequence {name}"),
                    reason,
                });
            }
        }
        if let Some(missing) = missing {
            let single = Single {
                reason: format!("there is no folder {missing}"),
                splits: BTreeMap::new(),
                classes,
                options,
            };
            return single.draft(source, left_only, problems);
        }
        stereo_draft(source, found, &classes, options, &BTreeMap::new(), problems)
    }
}

/// The folder that holds a folder a sequence, and their labels.
fn training_folder(source: &Path) -> Result<PathBuf> {
    [source.join("training"), source.to_path_buf()]
        .into_iter()
        .find(|folder| {
            let has_sequences = files_in(&folder.join("image_02"))
                .is_ok_and(|files| !files.folders.is_empty() && files.images.is_empty());
            has_sequences && folder.join("label_02").is_dir()
        })
        .ok_or_else(|| {
            Error::dataset(
                source,
                "has no folder training/image_02 with sequences, and label_02 beside it",
                "give the folder of KITTI's tracking set that holds `training`",
            )
        })
}

/// One sequence.
struct Sequence<'a> {
    training: &'a Path,
    name: &'a str,
    scene: u32,
}

/// The objects of one frame with the numbers of their tracks; none has a region without labels.
type Tracked = Vec<(Option<u32>, Object)>;

impl Sequence<'_> {
    /// The sequence's file in a folder.
    fn file_in(&self, folder: &str) -> PathBuf {
        let name = format!("{}.txt", self.name);
        self.training.join(folder).join(name)
    }

    /// The objects by frame; the reason against all of them in words.
    fn objects(&self) -> Result<BTreeMap<u32, Tracked>, String> {
        let text = files::read_text(self.file_in("label_02")).map_err(|error| error.to_string())?;
        parse_tracks(&text).map_err(|reason| format!("label_02/{}.txt {reason}", self.name))
    }

    /// Reads the left images alone; the reason against all of them in words.
    fn left_images(
        &self,
        left: &Path,
        problems: &mut Vec<Problem>,
    ) -> Result<Vec<LeftImage>, String> {
        let mut objects = self.objects()?;
        let left = image_files(left, problems).map_err(|error| error.to_string())?;
        let of = |(name, path): (String, PathBuf)| {
            let number = whole(&name, "the number of the frame");
            let tracked = number.map(|number| objects.remove(&number).unwrap_or_default());
            LeftImage {
                name: format!("{}/{name}", self.name),
                path,
                objects: tracked
                    .map(|tracked| tracked.into_iter().map(|(_, object)| object).collect()),
                scene: Some(self.scene),
            }
        };
        Ok(left.into_iter().map(of).collect())
    }

    /// Reads the frames; the reason against all of them in words.
    fn read(&self, left: &Path, problems: &mut Vec<Problem>) -> Result<Vec<Found>, String> {
        let said = |error: Error| error.to_string();
        let calibration = Calibration::read(&self.file_in("calib"))
            .map_err(|reason| format!("calibration: {reason}"))?;
        let mut objects = self.objects()?;
        let left = image_files(left, problems).map_err(said)?;
        let right = self.training.join("image_03").join(self.name);
        let right = image_files(&right, problems).map_err(said)?;
        let frames: Vec<(String, PathBuf, Tracked)> = left
            .into_iter()
            .map(|(name, path)| {
                let number = name.parse::<u32>().ok();
                let tracked = number.and_then(|number| objects.remove(&number));
                (name, path, tracked.unwrap_or_default())
            })
            .collect();
        let outcomes: Vec<Result<Found, Problem>> = frames
            .into_par_iter()
            .map(|(name, left, tracked)| {
                let right = right.get(&name).cloned();
                self.frame(&name, left, right, tracked, calibration)
                    .map_err(|reason| Problem {
                        subject: format!("{}/{name}", self.name),
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
        Ok(found)
    }

    fn frame(
        &self,
        name: &str,
        left: PathBuf,
        right: Option<PathBuf>,
        tracked: Tracked,
        calibration: Calibration,
    ) -> Result<Found, String> {
        // Without its number nobody knows what is in it.
        whole(name, "the number of the frame")?;
        let images = [left, right.ok_or("has no image in image_03")?];
        let size = |path: &Path| copy::dimensions(path).map_err(|error| error.to_string());
        let sizes = [size(&images[0])?, size(&images[1])?];
        let (ids, objects): (Vec<Option<u32>>, Vec<Object>) = tracked.into_iter().unzip();
        let right = objects.iter().map(|_| None).collect();
        Ok(Found {
            name: format!("{}/{name}", self.name),
            images,
            sizes,
            calibration,
            objects,
            right,
            ids: Some(numbered(&ids)),
            scene: Some(self.scene),
        })
    }
}

/// Every object's number: its track's where no other object of the frame has it, else a free one.
fn numbered(tracks: &[Option<u32>]) -> Vec<u32> {
    let mut taken = BTreeSet::new();
    let own: Vec<Option<u32>> = tracks
        .iter()
        .map(|track| track.filter(|track| taken.insert(*track)))
        .collect();
    let mut free = (0..).filter(|number| !taken.contains(number));
    own.into_iter()
        .map(|own| own.or_else(|| free.next()).unwrap_or(u32::MAX))
        .collect()
}

/// Reads a sequence's labels by frame; the reason against its first bad line.
fn parse_tracks(text: &str) -> Result<BTreeMap<u32, Tracked>, String> {
    let mut frames: BTreeMap<u32, Tracked> = BTreeMap::new();
    let lines = text.lines().enumerate();
    for (index, line) in lines.filter(|(_, line)| !line.trim().is_empty()) {
        let (frame, track, object) =
            parse_line(line).map_err(|why| format!("line {}: {why}", index + 1))?;
        frames.entry(frame).or_default().push((track, object));
    }
    Ok(frames)
}

/// Frame, track and object.
fn parse_line(line: &str) -> Result<(u32, Option<u32>, Object), String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [frame, track, object @ ..] = &words[..] else {
        return Err(format!("has {} words, not 17", words.len()));
    };
    let frame = whole(frame, "the frame")?;
    // Regions without labels have the track -1.
    let track = match *track {
        "-1" => None,
        track => Some(whole(track, "the track")?),
    };
    let object = Object::parse(&object.join(" ")).map_err(|why| {
        if words.len() == 17 || words.len() == 18 {
            why
        } else {
            format!("has {} words, not 17", words.len())
        }
    })?;
    Ok((frame, track, object))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_say_frame_track_and_object() {
        let car = "Car 0 0 0 20 20 40 30 1.5 1.6 4 0 1.7 12 0";
        let text = format!("3 7 {car}\n\n3 -1 DontCare {}\n4 7 {car}\n", &car[4..]);
        let frames = parse_tracks(&text).unwrap();
        let tracks: Vec<_> = frames[&3].iter().map(|(track, _)| *track).collect();
        assert_eq!((frames.len(), tracks), (2, vec![Some(7), None]));
        for (line, why) in [
            ("3 7 Car 0 0", "line 1: has 5 words, not 17"),
            ("3", "line 1: has 1 words"),
            (&format!("x 7 {car}"), "the frame"),
            (&format!("3 -2 {car}"), "the track"),
            (&format!("3 7 {}", car.replace("1.7", "nan")), "y is NaN"),
        ] {
            let reason = parse_tracks(line).unwrap_err();
            assert!(reason.contains(why), "{reason}");
        }
    }

    #[test]
    fn objects_keep_their_tracks_numbers_and_others_have_free_ones() {
        let tracks = [Some(5), None, Some(0), Some(5), None];
        assert_eq!(numbered(&tracks), [5, 1, 0, 2, 3]);
    }

    #[test]
    fn damaged_labels_are_refused_or_read_and_nothing_else() {
        let seeds: [&[u8]; 3] = [
            b"0 0 Car 0.00 0 -1.57 130.00 50.00 190.00 80.00 1.50 1.70 4.20 0.50 1.60 15.00 -1.57\n0 -1 DontCare -1 -1 -10 10.00 40.00 30.00 55.00 -1 -1 -1 -1000 -1000 -1000 -10\n",
            b"car 0.00 0 0.00 130 50 190 80 0.00 0.00 0.00 0.00 0.00 0.00 0.00\nCar 0 0 0 1 2 3 4\n",
            b"Car 0 0 0 20 20 40 30 1.5 1.6 4 0 1.7 12 0 0.98\n",
        ];
        crate::mutate::damaged(&seeds, |bytes| {
            let text = String::from_utf8_lossy(bytes);
            let tracked = parse_tracks(&text).unwrap_or_default();
            let tracked = tracked.into_values().flatten().map(|(_, object)| object);
            let objects = Object::parse_file(&text, "a.txt").unwrap_or_default();
            for object in tracked.chain(objects) {
                assert!(object.box_pixel.is_valid());
            }
        });
    }
}
