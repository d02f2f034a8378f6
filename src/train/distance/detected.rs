//! The boxes that the run's own detector finds around the training vehicles: what the distance
//! network will be given at work.

use std::collections::BTreeMap;
use std::path::Path;

use burn::tensor::Device;
use image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::dataset::{BoxKind, Frame, Split, StereoDataset};
use crate::detector::VehicleDetector;
use crate::detector::nms::NmsConfig;
use crate::error::{Error, Result};
use crate::evaluate::match_vehicles;
use crate::files;
use crate::geometry::{PixelBox, StereoRig};
use crate::pairing::search::search;
use crate::pipeline::{PredictOptions, Vehicle};
use crate::progress::{Progress, in_parallel};
use crate::train::StageFolder;

/// The file in the distance network's folder.
const FILE: &str = "detector_boxes.json";

/// Boxes of training vehicles, and the detector that they come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct DetectedBoxes {
    /// Length and check sum of the detector's weights.
    pub detector: String,
    /// Of the dataset.
    fingerprint: String,
    kind: BoxKind,
    vehicles: Vec<DetectedVehicle>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct DetectedVehicle {
    frame: u64,
    id: u32,
    left: PixelBox,
    right: PixelBox,
}

impl DetectedBoxes {
    /// Reads the boxes of a run, or finds and saves them where they are missing, of another
    /// detector or of another dataset.
    ///
    /// # Errors
    /// A run without a detector, images that cannot be read, or a device that fails.
    pub fn of_run(
        run: &Path,
        dataset: &StereoDataset,
        kind: BoxKind,
        device: &Device,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let weights = StageFolder::new(run, "detector").best();
        if !weights.exists() {
            return Err(Error::weights(
                weights,
                "does not exist, and distance.boxes = \"detector\" wants its boxes",
                format!(
                    "train the run's detector first: twinsight train detector --run {}",
                    run.display()
                ),
            ));
        }
        let folder = StageFolder::new(run, "distance");
        folder.create()?;
        let path = run.join("distance").join(FILE);
        let mut wanted = Self {
            detector: files::content_mark(&weights)?,
            fingerprint: dataset.fingerprint()?,
            kind,
            vehicles: Vec::new(),
        };
        if let Some(saved) = Self::read(&path)
            && saved.is_for(&wanted)
        {
            return Ok(saved);
        }
        let detector = VehicleDetector::load(&weights, &device.clone().without_autodiff())?;
        wanted.vehicles = find(&detector, dataset, kind, progress)?;
        let json = serde_json::to_vec(&wanted)
            .map_err(|error| Error::training(error.to_string(), "report this as a defect"))?;
        files::write_atomically(&path, &json)?;
        // What is read may differ from what was found in a last bit, and a resumed run reads.
        Self::read(&path).ok_or_else(|| {
            Error::training(
                format!("{} cannot be read back", path.display()),
                "run the command again",
            )
        })
    }

    /// None for a file that is missing or no longer readable: its content can be found again.
    fn read(path: &Path) -> Option<Self> {
        serde_json::from_str(&files::read_text(path).ok()?).ok()
    }

    fn is_for(&self, other: &Self) -> bool {
        (&self.detector, &self.fingerprint, self.kind)
            == (&other.detector, &other.fingerprint, other.kind)
    }

    /// The boxes by frame and vehicle.
    pub fn by_vehicle(&self) -> BTreeMap<(u64, u32), [PixelBox; 2]> {
        let vehicles = self.vehicles.iter();
        vehicles
            .map(|v| ((v.frame, v.id), [v.left, v.right]))
            .collect()
    }
}

/// Detects in all training frames, and looks for the right boxes, as prediction does unless it is
/// told otherwise.
fn find(
    detector: &VehicleDetector,
    dataset: &StereoDataset,
    kind: BoxKind,
    progress: &dyn Progress,
) -> Result<Vec<DetectedVehicle>> {
    let frames = dataset.split(Split::Train);
    let rig = dataset.rig();
    let found = in_parallel(
        progress,
        "distance, boxes of the detector",
        "run the same command again",
        &frames,
        |frame| {
            let [left, right] = frame.load(rig)?;
            find_in_frame(detector, frame, [&left, &right], kind, rig)
        },
    )?;
    Ok(found.into_iter().flatten().collect())
}

fn find_in_frame(
    detector: &VehicleDetector,
    frame: &Frame,
    images: [&RgbImage; 2],
    kind: BoxKind,
    rig: &StereoRig,
) -> Result<Vec<DetectedVehicle>> {
    let options = PredictOptions::default();
    let nms = NmsConfig {
        confidence: options.confidence,
        iou: options.iou,
        ..NmsConfig::prediction()
    };
    let left = detector
        .detect(&images[..1], &nms)?
        .into_iter()
        .next()
        .unwrap_or_default();
    let vehicles: Vec<Vehicle> = search(images, &left, rig, &options.pairing)
        .partners
        .iter()
        .map(|partner| Vehicle {
            score: left[partner.left].score,
            ..Vehicle::bare(
                left[partner.left].box_pixel,
                partner.box_pixel,
                "",
                f64::NAN,
            )
        })
        .collect();
    let labels = frame.vehicles(kind);
    let matches = match_vehicles(&vehicles, &labels);
    let mut detected: Vec<DetectedVehicle> = matches
        .into_iter()
        .map(|(vehicle, label)| DetectedVehicle {
            frame: frame.row.stamp,
            id: labels[label].id,
            left: vehicles[vehicle].left,
            right: vehicles[vehicle].right,
        })
        .collect();
    detected.sort_by_key(|vehicle| vehicle.id);
    Ok(detected)
}
