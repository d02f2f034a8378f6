//! What was estimated of each vehicle: the rows that every figure is computed from.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::dataset::{BoxKind, Frame, StereoDataset, StereoLabel, View, read_objects_csv};
use crate::generate::view_of_azimuth;
use crate::geometry::PixelBox;

/// A way to a distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The distance network.
    Network,
    /// Box width, with one fitted constant.
    Size,
    /// Disparity of the two boxes' centres.
    Triangulation,
    /// Sub-pixel disparity of the box's pixels, with one fitted constant.
    Matching,
    /// Linear fusion of size and matching.
    Fusion,
}

impl Method {
    /// The network, then the baselines.
    pub const ALL: [Self; 5] = [
        Self::Network,
        Self::Size,
        Self::Triangulation,
        Self::Matching,
        Self::Fusion,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Network => "network",
            Self::Size => "size",
            Self::Triangulation => "triangulation",
            Self::Matching => "matching",
            Self::Fusion => "fusion",
        }
    }
}

impl fmt::Display for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Where the boxes come from that a distance is estimated from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Boxes {
    /// The labels: judges the distance alone.
    #[serde(rename = "true boxes")]
    True,
    /// The detector and the pairing: judges the whole pipeline.
    #[serde(rename = "pipeline")]
    Pipeline,
}

impl Boxes {
    /// Both.
    pub const ALL: [Self; 2] = [Self::True, Self::Pipeline];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::True => "true boxes",
            Self::Pipeline => "pipeline",
        }
    }
}

impl fmt::Display for Boxes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// One estimate of each method, metres; None where a method has no answer.
pub type Estimates = [Option<f64>; 5];

/// A vehicle that is labelled in both images and ignored in neither, a row of `vehicles.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VehicleRow {
    /// The frame's number.
    #[serde(with = "crate::dataset::stamp")]
    pub frame: u64,
    /// The vehicle's number in the frame.
    pub id: u32,
    /// Its class.
    pub class: String,
    /// The frame's scene.
    pub scene: Option<u32>,
    /// The frame's sun.
    pub sun: Option<String>,
    /// The side from which it is seen.
    pub view: Option<View>,
    /// Longer side of its labelled box, mean of both images, pixels.
    pub box_px: f64,
    /// The true distance, metres.
    pub distance_m: f64,
    /// The network's estimate from the labelled boxes, metres.
    pub network_m: Option<f64>,
    /// As above, from the box size.
    pub size_m: Option<f64>,
    /// As above, from the centres of the boxes.
    pub triangulation_m: Option<f64>,
    /// As above, from sub-pixel disparity.
    pub matching_m: Option<f64>,
    /// As above, from size and disparity.
    pub fusion_m: Option<f64>,
    /// Whether the pipeline found it.
    pub found: bool,
    /// The detection's score.
    pub score: Option<f32>,
    /// Overlap of the detected and the labelled box, the smaller of both images, 0 to 1.
    pub overlap: Option<f64>,
    /// Left edge of the detected box in the left image, pixels.
    pub found_x_min: Option<f64>,
    /// Its upper edge.
    pub found_y_min: Option<f64>,
    /// Its right edge.
    pub found_x_max: Option<f64>,
    /// Its lower edge.
    pub found_y_max: Option<f64>,
    /// The pipeline's estimate, metres.
    pub pipeline_network_m: Option<f64>,
    /// From the detected boxes' size.
    pub pipeline_size_m: Option<f64>,
    /// From the centres of the detected boxes.
    pub pipeline_triangulation_m: Option<f64>,
    /// From sub-pixel disparity in the detected box.
    pub pipeline_matching_m: Option<f64>,
    /// From size and disparity of the detected boxes.
    pub pipeline_fusion_m: Option<f64>,
}

impl VehicleRow {
    /// The detected box in the left image, pixels.
    pub fn found_box(&self) -> Option<PixelBox> {
        Some(PixelBox::new(
            self.found_x_min?,
            self.found_y_min?,
            self.found_x_max?,
            self.found_y_max?,
        ))
    }

    /// Sets the detected box in the left image, pixels.
    pub(super) const fn set_found_box(&mut self, found: &PixelBox) {
        self.found_x_min = Some(found.x_min);
        self.found_y_min = Some(found.y_min);
        self.found_x_max = Some(found.x_max);
        self.found_y_max = Some(found.y_max);
    }

    /// A method's estimate from these boxes, metres.
    pub const fn estimate(&self, boxes: Boxes, method: Method) -> Option<f64> {
        match (boxes, method) {
            (Boxes::True, Method::Network) => self.network_m,
            (Boxes::True, Method::Size) => self.size_m,
            (Boxes::True, Method::Triangulation) => self.triangulation_m,
            (Boxes::True, Method::Matching) => self.matching_m,
            (Boxes::True, Method::Fusion) => self.fusion_m,
            (Boxes::Pipeline, Method::Network) => self.pipeline_network_m,
            (Boxes::Pipeline, Method::Size) => self.pipeline_size_m,
            (Boxes::Pipeline, Method::Triangulation) => self.pipeline_triangulation_m,
            (Boxes::Pipeline, Method::Matching) => self.pipeline_matching_m,
            (Boxes::Pipeline, Method::Fusion) => self.pipeline_fusion_m,
        }
    }

    /// Sets every method's estimate from these boxes.
    pub(crate) const fn set_estimates(&mut self, boxes: Boxes, estimates: Estimates) {
        let [network, size, triangulation, matching, fusion] = estimates;
        match boxes {
            Boxes::True => {
                self.network_m = network;
                self.size_m = size;
                self.triangulation_m = triangulation;
                self.matching_m = matching;
                self.fusion_m = fusion;
            }
            Boxes::Pipeline => {
                self.pipeline_network_m = network;
                self.pipeline_size_m = size;
                self.pipeline_triangulation_m = triangulation;
                self.pipeline_matching_m = matching;
                self.pipeline_fusion_m = fusion;
            }
        }
    }
}

/// What is known of the vehicles of a dataset beside their labels.
pub(crate) struct Places<'a> {
    dataset: &'a StereoDataset,
    kind: BoxKind,
    views: BTreeMap<(u64, u32), View>,
}

impl<'a> Places<'a> {
    /// Reads the dataset's `objects.csv`, which is optional and only there to know views: a file that
    /// cannot be read says nothing.
    pub fn new(dataset: &'a StereoDataset, kind: BoxKind) -> Self {
        let objects = read_objects_csv(dataset.folder.join("objects.csv")).unwrap_or_default();
        Self {
            dataset,
            kind,
            views: objects
                .iter()
                .map(|row| ((row.stamp, row.id), view_of_azimuth(row.azimuth_deg)))
                .collect(),
        }
    }

    /// The row of a vehicle without any estimate.
    pub fn unseen(&self, frame: &Frame, label: &StereoLabel) -> VehicleRow {
        let [left, right] = [&label.left.box_pixel, &label.right.box_pixel]
            .map(|area| area.width().max(area.height()));
        let class = self.dataset.classes().get(label.class as usize);
        // `frames.csv` speaks of the orbited vehicle, which has the number 0, or of the only one.
        let is_of_frame = label.id == 0 || frame.left.labels_of(self.kind).count() == 1;
        let of_object = self.views.get(&(frame.row.stamp, label.id)).copied();
        VehicleRow {
            frame: frame.row.stamp,
            id: label.id,
            class: class.cloned().unwrap_or_default(),
            scene: frame.row.scene,
            sun: frame.row.sun.clone(),
            view: frame.row.view.filter(|_| is_of_frame).or(of_object),
            box_px: f64::midpoint(left, right),
            distance_m: label.distance_m,
            network_m: None,
            size_m: None,
            triangulation_m: None,
            matching_m: None,
            fusion_m: None,
            found: false,
            score: None,
            overlap: None,
            found_x_min: None,
            found_y_min: None,
            found_x_max: None,
            found_y_max: None,
            pipeline_network_m: None,
            pipeline_size_m: None,
            pipeline_triangulation_m: None,
            pipeline_matching_m: None,
            pipeline_fusion_m: None,
        }
    }
}

/// A vehicle that the pipeline saw where none is labelled, a row of `false_vehicles.csv`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FalseVehicle {
    /// The frame's number.
    #[serde(with = "crate::dataset::stamp")]
    pub frame: u64,
    /// The class that was seen.
    pub class: String,
    /// The frame's scene.
    pub scene: Option<u32>,
    /// The frame's sun.
    pub sun: Option<String>,
    /// The detection's score.
    pub score: f32,
    /// The distance that was estimated, metres.
    pub estimated_m: f64,
    /// Edges of its box in the left image, pixels.
    pub x_min: f64,
    /// Upper edge.
    pub y_min: f64,
    /// Right edge.
    pub x_max: f64,
    /// Lower edge.
    pub y_max: f64,
}
