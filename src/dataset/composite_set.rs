//! Reads stage two's training data: the folder `composites` that [`prepare`](super::prepare())
//! made.

use std::fs;
use std::path::{Path, PathBuf};

use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::composite::CompositeSize;
use super::frame::Problem;
use super::{BoxKind, Split};
use crate::error::{Error, Result};
use crate::files;
use crate::imaging::{ChannelStatistics, load_rgb};

/// How many composites each split has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitCounts {
    /// Composites to learn from.
    pub train: u64,
    /// Composites that choose the best epoch.
    pub val: u64,
    /// Composites never seen in training.
    pub test: u64,
}

impl SplitCounts {
    /// The count of one split.
    pub fn of(&self, split: Split) -> u64 {
        match split {
            Split::Train => self.train,
            Split::Val => self.val,
            Split::Test => self.test,
        }
    }

    pub(crate) fn of_mut(&mut self, split: Split) -> &mut u64 {
        match split {
            Split::Train => &mut self.train,
            Split::Val => &mut self.val,
            Split::Test => &mut self.test,
        }
    }
}

/// `composites/statistics.toml`: how the composites were made, and the training split's channel
/// statistics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompositeStatistics {
    /// The kind of label whose boxes were cropped.
    pub kind: BoxKind,
    /// Changes when labels, splits or images change.
    pub fingerprint: String,
    /// Size of every composite.
    pub size: CompositeSize,
    /// Composites in each split.
    pub counts: SplitCounts,
    /// Over all training composites; absent when there are none, as in a pure test set.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub train: Option<ChannelStatistics>,
}

impl CompositeStatistics {
    /// Where the statistics of a dataset folder stand.
    pub fn path(dataset_folder: impl AsRef<Path>) -> PathBuf {
        dataset_folder
            .as_ref()
            .join("composites")
            .join("statistics.toml")
    }

    /// Reads the statistics of a dataset folder.
    ///
    /// # Errors
    /// [`Error::Dataset`] when the composites were not prepared or the file is damaged.
    pub fn read(dataset_folder: impl AsRef<Path>) -> Result<Self> {
        let path = Self::path(&dataset_folder);
        if !path.exists() {
            return Err(Error::dataset(
                dataset_folder,
                "has no finished composites",
                "run `twinsight prepare` on it",
            ));
        }
        toml::from_str(&files::read_text(&path)?).map_err(|error| {
            Error::dataset(
                &path,
                format!("cannot be read: {}", error.message()),
                "run `twinsight prepare` again",
            )
        })
    }

    pub(super) fn write(&self, dataset_folder: &Path) -> Result<()> {
        let path = Self::path(dataset_folder);
        let text = toml::to_string(self).map_err(|error| {
            Error::dataset(&path, error.to_string(), "run `twinsight prepare` again")
        })?;
        files::write_atomically(&path, text.as_bytes())
    }
}

/// One training example of stage two; the image stays on disk.
#[derive(Debug, Clone, PartialEq)]
pub struct CompositeItem {
    /// The composite's image file.
    pub path: PathBuf,
    /// The frame's stamp.
    pub stamp: u64,
    /// The vehicle's number in its frame.
    pub id: u32,
    /// The truth, metres.
    pub distance_m: f32,
    /// (`norm_w`, `norm_h`).
    pub geometry: [f32; 2],
}

impl CompositeItem {
    /// Decodes the composite.
    ///
    /// # Errors
    /// Those of [`load_rgb`], and a size other than the one it was prepared with.
    pub fn load(&self, size: CompositeSize) -> Result<RgbImage> {
        let image = load_rgb(&self.path)?;
        if image.dimensions() == (size.width, size.height) {
            return Ok(image);
        }
        Err(Error::image(
            &self.path,
            format!(
                "is {}x{} high x wide but statistics.toml says {size}",
                image.height(),
                image.width()
            ),
            "run `twinsight prepare` again",
        ))
    }
}

/// The prepared composites of one split.
#[derive(Debug, Clone, PartialEq)]
pub struct CompositeSet {
    /// How they were made, and the channel statistics.
    pub statistics: CompositeStatistics,
    /// The examples, by stamp and id.
    pub items: Vec<CompositeItem>,
    /// What had to be left out.
    pub problems: Vec<Problem>,
}

impl CompositeSet {
    /// Reads the composites of one split of a dataset folder.
    ///
    /// # Errors
    /// [`Error::Dataset`] when they were not prepared, or none is usable.
    pub fn open(dataset_folder: impl AsRef<Path>, split: Split) -> Result<Self> {
        let dataset_folder = dataset_folder.as_ref();
        let statistics = CompositeStatistics::read(dataset_folder)?;
        let folder = dataset_folder.join("composites").join(split.word());
        let mut items = Vec::new();
        let mut problems = Vec::new();
        for (stamp, id, name) in composites_in(&folder)? {
            let path = folder.join(format!("{name}.png"));
            match read_line(&path.with_extension("txt")) {
                Ok((distance_m, geometry)) => {
                    items.push(CompositeItem {
                        path,
                        stamp,
                        id,
                        distance_m,
                        geometry,
                    });
                }
                Err(reason) => problems.push(Problem {
                    subject: format!("composite {split}/{name}"),
                    reason,
                }),
            }
        }
        let missing = statistics
            .counts
            .of(split)
            .saturating_sub((items.len() + problems.len()) as u64);
        if missing > 0 {
            problems.push(Problem {
                subject: format!("composites/{split}"),
                reason: format!("{missing} of {} are gone", statistics.counts.of(split)),
            });
        }
        if items.is_empty() {
            let problem = if problems.is_empty() {
                "holds no composites".to_owned()
            } else {
                format!("holds no usable composite: {}", Problem::summary(&problems))
            };
            return Err(Error::dataset(
                folder,
                problem,
                format!(
                    "run `twinsight prepare` again, or give the dataset frames of split {split}"
                ),
            ));
        }
        Ok(Self {
            statistics,
            items,
            problems,
        })
    }
}

/// Stamp and vehicle of a composite's file name without extension, `00042_7`.
fn parse_name(stem: &str) -> Option<(u64, u32)> {
    let (stamp, id) = stem.split_once('_')?;
    let are_numbers = stem
        .bytes()
        .all(|byte| byte.is_ascii_digit() || byte == b'_');
    Some((
        are_numbers.then_some(stamp)?.parse().ok()?,
        id.parse().ok()?,
    ))
}

/// Whether a file of this name, given without extension, is a composite.
pub(super) fn is_composite_name(stem: &str) -> bool {
    parse_name(stem).is_some()
}

/// The composites in a split's folder: stamp, id and name without extension, in this order.
pub(super) fn composites_in(folder: &Path) -> Result<Vec<(u64, u32, String)>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).map_err(Error::io("read", folder))? {
        let path = entry.map_err(Error::io("read", folder))?.path();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        if let Some(stem) = name.strip_suffix(".png")
            && let Some((stamp, id)) = parse_name(stem)
        {
            found.push((stamp, id, stem.to_owned()));
        }
    }
    found.sort();
    Ok(found)
}

/// Reads `distance_m,norm_w,norm_h`.
fn read_line(path: &Path) -> Result<(f32, [f32; 2]), String> {
    let text = files::read_text(path).map_err(|error| error.to_string())?;
    let numbers: Vec<f32> = text
        .trim()
        .split(',')
        .map(|field| field.trim().parse())
        .collect::<Result<_, std::num::ParseFloatError>>()
        .map_err(|error| format!("'{}' is not distance_m,norm_w,norm_h: {error}", text.trim()))?;
    match numbers[..] {
        [distance_m, norm_w, norm_h]
            if [distance_m, norm_w, norm_h]
                .iter()
                .all(|value| value.is_finite() && *value > 0.0) =>
        {
            Ok((distance_m, [norm_w, norm_h]))
        }
        _ => Err(format!("'{}' is not three positive numbers", text.trim())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixture::Fixture;
    use crate::dataset::prepare;
    use crate::progress::Silent;

    fn prepared() -> Fixture {
        let fixture = Fixture::new(5);
        prepare(
            &fixture.open(),
            BoxKind::Sphere,
            CompositeSize::SMALLEST,
            &Silent,
        )
        .unwrap();
        fixture
    }

    fn refusal(fixture: &Fixture, split: Split) -> String {
        CompositeSet::open(fixture.root(), split)
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn what_was_not_prepared_is_refused_with_the_command() {
        let message = refusal(&Fixture::new(1), Split::Train);
        assert!(message.contains("twinsight prepare"), "{message}");
        let fixture = prepared();
        fixture.write("composites/statistics.toml", "kind = \"sphere\"\n");
        assert!(refusal(&fixture, Split::Train).contains("cannot be read"));
    }

    #[test]
    fn damaged_and_missing_composites_are_reported() {
        let fixture = prepared();
        fixture.write("composites/train/00001_3.txt", "12,NaN,0.5\n");
        fixture.remove("composites/train/00002_3.png");
        let set = CompositeSet::open(fixture.root(), Split::Train).unwrap();
        assert_eq!(set.items.len(), 1);
        let texts: Vec<_> = set.problems.iter().map(ToString::to_string).collect();
        assert!(
            texts[0].contains("train/00001_3") && texts[0].contains("three positive"),
            "{texts:?}"
        );
        assert!(texts[1].contains("1 of 3 are gone"), "{texts:?}");
        fixture.remove("composites/val/00004_3.txt");
        assert!(refusal(&fixture, Split::Val).contains("00004_3"));
    }

    #[test]
    fn a_composite_of_another_size_is_refused() {
        let fixture = prepared();
        let set = CompositeSet::open(fixture.root(), Split::Val).unwrap();
        let message = set.items[0]
            .load(CompositeSize::QUICK)
            .unwrap_err()
            .to_string();
        assert!(
            message.contains("324x162") && message.contains("340x170"),
            "{message}"
        );
    }
}
