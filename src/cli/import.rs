//! `twinsight import`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use twinsight::Result;
use twinsight::dataset::Problem;
use twinsight::formats::{
    ClassMap, ImportOptions, ImportReport, ImportTarget, SplitSettings, import,
};

use super::values::{ImageSize, share};
use super::{stderr, stdout, terminal};

/// Subjects that are named for one reason; the rest is counted.
const NAMED: usize = 12;

/// Turn a dataset of another format into one that can be trained on
///
/// Images are copied as they are (PNG or JPEG; others become PNG) unless they have to be turned as
/// their files say or brought to the size of the others. Everything that had to be left out is named with its reason; `sources.csv` in the new
/// dataset says which frame came from which file.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct ImportArgs {
    #[command(subcommand)]
    format: Format,
}

const EXAMPLES: &str = "\
Examples:
  KITTI's stereo pairs, cars and vans as one class, the drives kept apart:

    twinsight import kitti kitti --classes car=Car+Van --groups drives.csv --out datasets/kitti

  A YOLO dataset of single images, for the detector alone:

    twinsight import yolo vehicles/data.yaml --out datasets/vehicles
    twinsight train detector --data datasets/vehicles --box-kind tight";

#[derive(Debug, Subcommand)]
enum Format {
    Kitti(KittiArgs),
    Vkitti2(Vkitti2Args),
    Yolo(YoloArgs),
    Coco(CocoArgs),
    Auto(AutoArgs),
}

/// What all formats have in common.
#[derive(Debug, Args)]
struct Common {
    /// Folder of the new dataset
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The classes to take, each with the foreign names that stand for it, such as
    /// `car=Car+Van,walker=Pedestrian`; other objects are left out
    #[arg(long, value_name = "MAP")]
    classes: Option<ClassMap>,
    /// CSV file that says what belongs together: a column `id`, `name`, `file`, `image` or `stamp`
    /// names the frame, and a column `drive`, `raw_drive`, `scene`, `sequence` or `group` its
    /// group, which is never split; a column `split` settles it by itself
    #[arg(long, value_name = "FILE")]
    groups: Option<PathBuf>,
    /// Part of the frames that validates, where neither the source nor the table says
    #[arg(long, value_name = "PART", default_value_t = 0.2, value_parser = share::<f32>)]
    val_fraction: f32,
    /// The random split follows from it
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Common {
    fn target(&self) -> ImportTarget {
        ImportTarget {
            out: self.out.clone(),
            classes: self.classes.clone(),
            splits: SplitSettings {
                table: self.groups.clone(),
                val_fraction: f64::from(self.val_fraction),
                seed: self.seed,
            },
        }
    }
}

/// KITTI's folder of objects or of tracks: stereo pairs, boxes in the image and in space
///
/// Sequences of the tracking set stay apart in the splits. Where there are no right images, no
/// calibrations or no places in space, the left images become single ones, for a detector.
///
/// Car, Van and Truck become the class `car` unless `--classes` says otherwise. Distances run from
/// the middle between the cameras to the centre of the box in space. Right boxes are those of
/// `label_3` where it exists; otherwise the left box is moved as the projected box in space moves.
/// Ignored, which means neither learnt nor judged, are `DontCare` regions and vehicles that are
/// hidden or cut off too much.
#[derive(Debug, Args)]
struct KittiArgs {
    /// The folder that holds `training`
    source: PathBuf,
    /// KITTI has several calibrations and a dataset one rig: 1 is the most common, 2 the next
    #[arg(long, value_name = "N", default_value_t = 1)]
    rig: usize,
    /// Ignore vehicles that are hidden more than this: 0 not at all, 1 partly, 2 largely
    #[arg(long, value_name = "LEVEL", default_value_t = 2, value_parser = clap::value_parser!(u8).range(0..=3))]
    max_occluded: u8,
    /// Ignore vehicles of which a larger part lies outside the image
    #[arg(long, value_name = "PART", default_value_t = 0.5, value_parser = share::<f32>)]
    max_truncated: f32,
    /// Size of all images where they become single ones, pixels [default: as large as the largest]
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    size: Option<ImageSize>,
    #[command(flatten)]
    common: Common,
}

/// Virtual KITTI 2: rendered streets in several weathers and times of day
///
/// Needs the archives `rgb` and `textgt`, unpacked into one folder. Scenes stay apart in the
/// splits. Car, Van and Truck become the class `car` unless `--classes` says otherwise.
#[derive(Debug, Args)]
struct Vkitti2Args {
    /// The folder that holds `Scene01` and so on
    source: PathBuf,
    /// Take only these variants, such as `clone,sunset`
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    variants: Vec<String>,
    /// Ignore vehicles of which a smaller part is visible
    #[arg(long, value_name = "PART", default_value_t = 0.25, value_parser = share::<f32>)]
    min_visible: f32,
    #[command(flatten)]
    common: Common,
}

/// What the files of a heap of images do not say.
#[derive(Debug, Args)]
struct Heap {
    /// Take every image by itself, even where names speak of left and right ones
    #[arg(long)]
    single: bool,
    /// Distance between the cameras of stereo pairs, metres
    #[arg(long, value_name = "M", requires = "hfov_deg")]
    baseline_m: Option<f64>,
    /// Horizontal field of view of the cameras of stereo pairs, degrees
    #[arg(long, value_name = "DEG", requires = "baseline_m")]
    hfov_deg: Option<f64>,
    /// Size of all single images, pixels: larger ones are shrunk, smaller ones filled up with
    /// black [default: as large as the largest]
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    size: Option<ImageSize>,
}

impl Heap {
    fn options(&self) -> ImportOptions {
        ImportOptions {
            single: self.single,
            baseline_m: self.baseline_m,
            hfov_deg: self.hfov_deg,
            canvas: canvas(self.size),
            ..ImportOptions::default()
        }
    }
}

fn canvas(size: Option<ImageSize>) -> Option<[u32; 2]> {
    size.map(|size| [size.width, size.height])
}

/// YOLO's text files with a data.yaml, optionally with the distance as a sixth number
///
/// Of key points (`kpt_shape`) the box is taken, of polygons the box around them. A sixth number is a
/// detector's confidence unless it is said to be a distance.
///
/// Images called `left_NAME` and `right_NAME`, or in folders `left` and `right`, become stereo
/// pairs. All others become single images, on which a detector can be trained.
#[derive(Debug, Args)]
struct YoloArgs {
    /// `data.yaml` or the folder that holds it
    source: PathBuf,
    #[command(flatten)]
    lines: Lines,
    #[command(flatten)]
    heap: Heap,
    #[command(flatten)]
    common: Common,
}

/// What the lines of YOLO's labels mean.
#[derive(Debug, Args)]
struct Lines {
    /// A number behind the box is its distance in metres
    #[arg(long)]
    distance_column: bool,
    /// Folders without any label file are meant: nothing is to be found in their images
    #[arg(long)]
    background: bool,
}

/// COCO's instance annotations
///
/// Images called `left_NAME` and `right_NAME`, or in folders `left` and `right`, become stereo
/// pairs. All others become single images, on which a detector can be trained. Crowds are ignored.
#[derive(Debug, Args)]
struct CocoArgs {
    /// A JSON file, or a folder with JSON files in it, in its folder `annotations` or in a folder for
    /// each split, as Roboflow writes them
    source: PathBuf,
    /// Folder of the images, where it is not beside the annotations
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    #[command(flatten)]
    heap: Heap,
    #[command(flatten)]
    common: Common,
}

/// Any of these formats, as its files say
///
/// With the usual settings of that format; the commands for each have more.
#[derive(Debug, Args)]
struct AutoArgs {
    /// The folder or file of the dataset
    source: PathBuf,
    #[command(flatten)]
    lines: Lines,
    #[command(flatten)]
    heap: Heap,
    #[command(flatten)]
    common: Common,
}

impl Format {
    /// The format's word, its source, and what is said beside it.
    fn parts(&self) -> (&'static str, &Path, ImportOptions, &Common) {
        let with_lines = |lines: &Lines, options| ImportOptions {
            distance_column: lines.distance_column,
            background: lines.background,
            ..options
        };
        match self {
            Self::Kitti(args) => {
                let options = ImportOptions {
                    rig: args.rig,
                    most_occluded: args.max_occluded,
                    most_truncated: f64::from(args.max_truncated),
                    canvas: canvas(args.size),
                    ..ImportOptions::default()
                };
                ("kitti", &args.source, options, &args.common)
            }
            Self::Vkitti2(args) => {
                let options = ImportOptions {
                    variants: args.variants.clone(),
                    least_visible: f64::from(args.min_visible),
                    ..ImportOptions::default()
                };
                ("vkitti2", &args.source, options, &args.common)
            }
            Self::Yolo(args) => {
                let options = with_lines(&args.lines, args.heap.options());
                ("yolo", &args.source, options, &args.common)
            }
            Self::Coco(args) => {
                let options = ImportOptions {
                    images: args.images.clone(),
                    ..args.heap.options()
                };
                ("coco", &args.source, options, &args.common)
            }
            Self::Auto(args) => {
                let options = with_lines(&args.lines, args.heap.options());
                ("auto", &args.source, options, &args.common)
            }
        }
    }
}

impl ImportArgs {
    /// Imports a dataset.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let (format, source, options, common) = self.format.parts();
        let report = terminal::with_progress(quiet, |progress| {
            import(format, source, &options, &common.target(), progress)
        })?;
        if !quiet {
            for line in left_out(&report.left_out) {
                stderr::line(&line);
            }
        }
        let out = common.out.display();
        stdout::print(&format!("dataset {out}: {}\n", summary(&report)))
    }
}

fn summary(report: &ImportReport) -> String {
    let counts = report.counts;
    let mut text = format!(
        "{} frames ({} train, {} val, {} test), {} vehicles",
        report.frames(),
        counts.train,
        counts.val,
        counts.test,
        report.vehicles
    );
    // Writing to a String cannot fail.
    if report.ignored > 0 {
        write!(text, ", {} of them ignored", report.ignored).ok();
    }
    if report.unlabelled > 0 {
        write!(text, ", {} images without a label file", report.unlabelled).ok();
    }
    if report.with_distance < report.vehicles {
        write!(text, ", {} with a distance", report.with_distance).ok();
    }
    text
}

/// What was left out, a line a reason.
pub fn left_out(problems: &[Problem]) -> Vec<String> {
    let mut by_reason: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for problem in problems {
        by_reason
            .entry(&problem.reason)
            .or_default()
            .push(&problem.subject);
    }
    let line = |(reason, subjects): (&str, Vec<&str>)| {
        let named: Vec<&str> = subjects.iter().take(NAMED).copied().collect();
        let more = match subjects.len() - named.len() {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        format!("left out {}{more}: {reason}", named.join(", "))
    };
    by_reason.into_iter().map(line).collect()
}
