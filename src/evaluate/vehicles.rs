//! What was estimated of each vehicle: the rows that every figure is computed from.

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::dataset::{BoxKind, Frame, StereoDataset, StereoLabel, View, read_objects_csv};
use crate::generate::view_of_azimuth;
use crate::geometry::PixelBox;
use crate::ranging::{Posterior, RangerKind};

/// A way to a distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The posterior from size, disparity and, where it is trained, the size network: its median.
    Fused,
    /// The paper's twin-branch network.
    Network,
    /// Box width, with one fitted constant.
    Size,
    /// Disparity of the two boxes' centres.
    Triangulation,
    /// Sub-pixel disparity of the box's pixels, with one fitted constant.
    Matching,
}

impl Method {
    /// The rangers, then the baselines.
    pub const ALL: [Self; 5] = [
        Self::Fused,
        Self::Network,
        Self::Size,
        Self::Triangulation,
        Self::Matching,
    ];

    /// What a ranger is called as a method.
    pub const fn of_ranger(kind: RangerKind) -> Self {
        match kind {
            RangerKind::Fused => Self::Fused,
            RangerKind::Paper => Self::Network,
        }
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Fused => "fused",
            Self::Network => "network",
            Self::Size => "size",
            Self::Triangulation => "triangulation",
            Self::Matching => "matching",
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

/// One estimate of each method, metres, in the order of [`Method::ALL`]; None where a method has no
/// answer.
pub type Estimates = [Option<f64>; 5];

/// What a posterior says of a vehicle beside its median.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// Standard deviation, metres.
    pub std_m: f64,
    /// Bounds of the interval that holds the distance with a probability of 68 %, metres.
    pub within_68_m: [f64; 2],
    /// And with 95 %.
    pub within_95_m: [f64; 2],
    /// Negative logarithm of the density at the true distance, per metre.
    pub nll: f64,
    /// Probability that the vehicle is nearer than it is.
    pub below: f64,
}

/// Least density that the likelihood counts: a posterior ends with its grid.
const LEAST_DENSITY: f64 = 1e-9;

impl Spread {
    /// Of a posterior, given the true distance.
    pub fn new(posterior: &Posterior, true_m: f64) -> Self {
        Self {
            std_m: posterior.std_m(),
            within_68_m: posterior.interval_m(0.68),
            within_95_m: posterior.interval_m(0.95),
            nll: -libm::log(posterior.density_at(true_m).max(LEAST_DENSITY)),
            below: posterior.probability_below(true_m),
        }
    }
}

/// A vehicle that is labelled in both images and ignored in neither, a row of `vehicles.csv`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
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
    /// The posterior's median from the labelled boxes, metres.
    pub fused_m: Option<f64>,
    /// Its standard deviation, metres.
    pub fused_std_m: Option<f64>,
    /// Bound of its 68 % interval, metres.
    pub fused_low_68_m: Option<f64>,
    /// Bound of its 68 % interval, metres.
    pub fused_high_68_m: Option<f64>,
    /// Bound of its 95 % interval, metres.
    pub fused_low_m: Option<f64>,
    /// Bound of its 95 % interval, metres.
    pub fused_high_m: Option<f64>,
    /// Negative logarithm of its density at the truth, per metre.
    pub fused_nll: Option<f64>,
    /// Its probability that the vehicle is nearer than it is.
    pub fused_below: Option<f64>,
    /// The network's estimate from the labelled boxes, metres.
    pub network_m: Option<f64>,
    /// As above, from the box size.
    pub size_m: Option<f64>,
    /// As above, from the centres of the boxes.
    pub triangulation_m: Option<f64>,
    /// As above, from sub-pixel disparity.
    pub matching_m: Option<f64>,
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
    /// The posterior's median from the detected boxes, metres.
    pub pipeline_fused_m: Option<f64>,
    /// Its standard deviation, metres.
    pub pipeline_fused_std_m: Option<f64>,
    /// Bound of its 68 % interval, metres.
    pub pipeline_fused_low_68_m: Option<f64>,
    /// Bound of its 68 % interval, metres.
    pub pipeline_fused_high_68_m: Option<f64>,
    /// Bound of its 95 % interval, metres.
    pub pipeline_fused_low_m: Option<f64>,
    /// Bound of its 95 % interval, metres.
    pub pipeline_fused_high_m: Option<f64>,
    /// Negative logarithm of its density at the truth, per metre.
    pub pipeline_fused_nll: Option<f64>,
    /// Its probability that the vehicle is nearer than it is.
    pub pipeline_fused_below: Option<f64>,
    /// The network's estimate from the detected boxes, metres.
    pub pipeline_network_m: Option<f64>,
    /// From the detected boxes' size.
    pub pipeline_size_m: Option<f64>,
    /// From the centres of the detected boxes.
    pub pipeline_triangulation_m: Option<f64>,
    /// From sub-pixel disparity in the detected box.
    pub pipeline_matching_m: Option<f64>,
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
            (Boxes::True, Method::Fused) => self.fused_m,
            (Boxes::Pipeline, Method::Network) => self.pipeline_network_m,
            (Boxes::Pipeline, Method::Size) => self.pipeline_size_m,
            (Boxes::Pipeline, Method::Triangulation) => self.pipeline_triangulation_m,
            (Boxes::Pipeline, Method::Matching) => self.pipeline_matching_m,
            (Boxes::Pipeline, Method::Fused) => self.pipeline_fused_m,
        }
    }

    /// What the posterior from these boxes says beside its median.
    pub fn spread(&self, boxes: Boxes) -> Option<Spread> {
        Some(match boxes {
            Boxes::True => Spread {
                std_m: self.fused_std_m?,
                within_68_m: [self.fused_low_68_m?, self.fused_high_68_m?],
                within_95_m: [self.fused_low_m?, self.fused_high_m?],
                nll: self.fused_nll?,
                below: self.fused_below?,
            },
            Boxes::Pipeline => Spread {
                std_m: self.pipeline_fused_std_m?,
                within_68_m: [
                    self.pipeline_fused_low_68_m?,
                    self.pipeline_fused_high_68_m?,
                ],
                within_95_m: [self.pipeline_fused_low_m?, self.pipeline_fused_high_m?],
                nll: self.pipeline_fused_nll?,
                below: self.pipeline_fused_below?,
            },
        })
    }

    /// Sets what the posterior from these boxes says beside its median.
    pub(super) const fn set_spread(&mut self, boxes: Boxes, spread: &Spread) {
        let ([low_68, high_68], [low, high]) = (spread.within_68_m, spread.within_95_m);
        match boxes {
            Boxes::True => {
                self.fused_std_m = Some(spread.std_m);
                self.fused_low_68_m = Some(low_68);
                self.fused_high_68_m = Some(high_68);
                self.fused_low_m = Some(low);
                self.fused_high_m = Some(high);
                self.fused_nll = Some(spread.nll);
                self.fused_below = Some(spread.below);
            }
            Boxes::Pipeline => {
                self.pipeline_fused_std_m = Some(spread.std_m);
                self.pipeline_fused_low_68_m = Some(low_68);
                self.pipeline_fused_high_68_m = Some(high_68);
                self.pipeline_fused_low_m = Some(low);
                self.pipeline_fused_high_m = Some(high);
                self.pipeline_fused_nll = Some(spread.nll);
                self.pipeline_fused_below = Some(spread.below);
            }
        }
    }

    /// Sets every method's estimate from these boxes.
    pub(crate) const fn set_estimates(&mut self, boxes: Boxes, estimates: Estimates) {
        let [fused, network, size, triangulation, matching] = estimates;
        match boxes {
            Boxes::True => {
                self.network_m = network;
                self.size_m = size;
                self.triangulation_m = triangulation;
                self.matching_m = matching;
                self.fused_m = fused;
            }
            Boxes::Pipeline => {
                self.pipeline_network_m = network;
                self.pipeline_size_m = size;
                self.pipeline_triangulation_m = triangulation;
                self.pipeline_matching_m = matching;
                self.pipeline_fused_m = fused;
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
            ..VehicleRow::default()
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
