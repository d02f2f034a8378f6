//! Datasets as Burn's data loaders take them: items by index, decoded when they are asked for.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use burn_dataset::{Dataset, DatasetError};
use image::RgbImage;

use super::cache::DecodedCache;
use super::composite_set::CompositeSet;
use super::frame::Side;
use super::reader::StereoDataset;
use super::{BoxKind, Split};
use crate::error::Result;
use crate::geometry::{Camera, PixelBox};

/// One image with the boxes that a detector should find in it.
#[derive(Debug, Clone)]
pub struct DetectionItem {
    /// The decoded image.
    pub image: Arc<RgbImage>,
    /// Class and box, pixels of the full image, clipped to it.
    pub boxes: Vec<(u32, PixelBox)>,
    /// Boxes of vehicles that may be found or not, pixels of the full image, clipped to it.
    pub ignored: Vec<PixelBox>,
    /// The image file.
    pub path: PathBuf,
    /// The frame's stamp.
    pub stamp: u64,
    /// Which camera's image it is.
    pub side: Side,
}

/// All images of every frame of a split, for the detector: left and right of a frame in turn.
#[derive(Debug)]
pub struct DetectionSource {
    entries: Vec<DetectionEntry>,
    cache: DecodedCache<usize, RgbImage>,
}

#[derive(Debug)]
struct DetectionEntry {
    image: super::FrameImage,
    camera: Camera,
    stamp: u64,
    side: Side,
    boxes: Vec<(u32, PixelBox)>,
    ignored: Vec<PixelBox>,
}

impl DetectionSource {
    /// The images of one split with their boxes of one kind; up to `cache_bytes` of decoded images
    /// are kept in memory.
    pub fn new(dataset: &StereoDataset, split: Split, kind: BoxKind, cache_bytes: usize) -> Self {
        let rig = dataset.rig();
        let entries = dataset
            .split(split)
            .into_iter()
            .flat_map(|frame| {
                frame
                    .images()
                    .map(move |(side, image)| (frame, side, image))
            })
            .map(|(frame, side, image)| {
                let camera = *rig.camera(side);
                DetectionEntry {
                    boxes: image.boxes(kind, &camera),
                    ignored: image.ignored_boxes(kind, &camera),
                    image: image.clone(),
                    camera,
                    stamp: frame.row.stamp,
                    side,
                }
            })
            .collect();
        Self {
            entries,
            cache: DecodedCache::new(cache_bytes),
        }
    }
}

impl DetectionSource {
    /// The image file of an item.
    pub(crate) fn path(&self, item: usize) -> Option<&Path> {
        Some(&self.entries.get(item)?.image.path)
    }
}

impl Dataset<DetectionItem> for DetectionSource {
    fn get(&self, index: usize) -> Result<DetectionItem, DatasetError> {
        let entry = &self.entries[index];
        let image = self
            .cache
            .get(index, || entry.image.load(&entry.camera))
            .map_err(DatasetError::new)?;
        Ok(DetectionItem {
            image,
            boxes: entry.boxes.clone(),
            ignored: entry.ignored.clone(),
            path: entry.image.path.clone(),
            stamp: entry.stamp,
            side: entry.side,
        })
    }

    fn len(&self) -> usize {
        self.entries.len()
    }
}

/// One composite with its truth.
#[derive(Debug, Clone)]
pub struct RangingItem {
    /// The decoded composite, right crop on top.
    pub composite: Arc<RgbImage>,
    /// The truth, metres.
    pub distance_m: f32,
    /// (`norm_w`, `norm_h`).
    pub geometry: [f32; 2],
    /// The composite's image file.
    pub path: PathBuf,
    /// The frame's stamp.
    pub stamp: u64,
    /// The vehicle's number in its frame.
    pub id: u32,
}

/// The composites of a split, for the ranging network.
#[derive(Debug)]
pub struct RangingSource {
    set: CompositeSet,
    cache: DecodedCache<usize, RgbImage>,
}

impl RangingSource {
    /// The composites of a set; up to `cache_bytes` of decoded images are kept in memory.
    pub fn new(set: CompositeSet, cache_bytes: usize) -> Self {
        Self {
            set,
            cache: DecodedCache::new(cache_bytes),
        }
    }

    /// The set behind it, with its statistics.
    pub fn set(&self) -> &CompositeSet {
        &self.set
    }
}

impl Dataset<RangingItem> for RangingSource {
    fn get(&self, index: usize) -> Result<RangingItem, DatasetError> {
        let item = &self.set.items[index];
        let composite = self
            .cache
            .get(index, || item.load(self.set.statistics.size))
            .map_err(DatasetError::new)?;
        Ok(RangingItem {
            composite,
            distance_m: item.distance_m,
            geometry: item.geometry,
            path: item.path.clone(),
            stamp: item.stamp,
            id: item.id,
        })
    }

    fn len(&self) -> usize {
        self.set.items.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::fixture::{Fixture, HEIGHT, WIDTH, picture};
    use crate::dataset::{CompositeSize, prepare};
    use crate::progress::Silent;

    const IMAGE_BYTES: usize = (3 * WIDTH * HEIGHT) as usize;

    #[test]
    fn detection_items_are_both_images_of_each_frame_with_their_boxes() {
        let fixture = Fixture::new(5);
        let source =
            DetectionSource::new(&fixture.open(), Split::Train, BoxKind::Sphere, usize::MAX);
        assert_eq!(source.len(), 6);
        let right = source.get(3).unwrap();
        assert_eq!((right.stamp, right.side), (2, Side::Right));
        assert_eq!(*right.image, picture(2, "right"));
        assert_eq!(right.boxes, [(0, PixelBox::new(22.0, 10.0, 52.0, 40.0))]);
    }

    #[test]
    fn the_cache_holds_no_more_than_its_budget_and_changes_no_item() {
        let fixture = Fixture::new(5);
        let dataset = fixture.open();
        for (budget, held) in [(0, 0), (2 * IMAGE_BYTES + 1, 2), (usize::MAX, 6)] {
            let source = DetectionSource::new(&dataset, Split::Train, BoxKind::Sphere, budget);
            for _ in 0..2 {
                for index in 0..source.len() {
                    let item = source.get(index).unwrap();
                    assert_eq!(*item.image, picture(item.stamp, item.side.word()));
                }
            }
            assert_eq!(source.cache.held(), (held, held * IMAGE_BYTES));
        }
    }

    #[test]
    fn an_image_that_breaks_later_is_an_error_of_its_item_alone() {
        let fixture = Fixture::new(5);
        let dataset = fixture.open();
        fixture.remove("frames/left_00002.png");
        let source = DetectionSource::new(&dataset, Split::Train, BoxKind::Sphere, 0);
        let message = source.get(2).unwrap_err().to_string();
        assert!(message.contains("left_00002.png"), "{message}");
        source.get(3).unwrap();
    }

    #[test]
    fn ranging_items_carry_composite_truth_and_geometry() {
        let fixture = Fixture::new(5);
        let size = CompositeSize::SMALLEST;
        prepare(&fixture.open(), BoxKind::Sphere, size, &Silent).unwrap();
        let set = CompositeSet::open(fixture.root(), Split::Train).unwrap();
        let source = RangingSource::new(set, usize::MAX);
        assert_eq!(source.len(), 3);
        let item = source.get(2).unwrap();
        assert_eq!((item.stamp, item.id, item.distance_m), (3, 3, 13.0));
        assert_eq!(item.composite.dimensions(), (size.width, size.height));
        assert_eq!(item.geometry, source.set().items[2].geometry);
    }
}
