//! `twinsight generate`.

use std::path::{Path, PathBuf};

use clap::Args;
use twinsight::Result;
use twinsight::generate::{
    Assets, GenerateConfig, GenerateReport, VehicleCount, add_frames, generate,
};

use super::values::ImageSize;
use super::{presets, stdout, terminal};

/// Make a dataset: stereo pairs of vehicles in procedural cities, with labels
///
/// Nothing is downloaded and no simulator is needed. The same settings give the same files, byte by
/// byte, on every machine. A generation that was stopped, or killed, goes on when it is started again
/// with the same settings and folder; one that is finished grows with `--add`, or with more
/// `--frames` and the same settings. Time and disk are told after the first frame, and a disk that is
/// too small is refused.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct GenerateArgs {
    /// Settings that come with the program: `quick` has 360 small frames up to 40 m and takes
    /// three minutes, `paper` has 7000 frames of 2048x1152 up to 200 m and takes hours
    #[arg(long, value_parser = presets::names(), default_value = presets::DEFAULT, conflicts_with = "config")]
    preset: String,
    /// Settings from a TOML file; what it leaves out is as in `quick`, but for the vehicles, which
    /// then have all 11 bodies and 18 paints (`quick` has 7 and 14), and without test frames
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Number of training and validation frames; those of the test protocol come on top
    #[arg(long, value_name = "N")]
    frames: Option<u32>,
    /// Make no frames of the test protocol
    #[arg(long)]
    no_test: bool,
    /// Vehicles of a scene: a number, or a range such as `4-8`; one of them is the target
    #[arg(long, value_name = "N", value_parser = vehicles)]
    vehicles: Option<VehicleCount>,
    /// What to write beside images and labels
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = OUTPUTS)]
    outputs: Vec<String>,
    /// Add N training and validation frames, with scenes of their own, to the finished dataset in
    /// `--out`, with the settings that made it; what is there stays as it is
    #[arg(long, value_name = "N", requires = "out", conflicts_with_all =
        ["preset", "config", "frames", "no_test", "vehicles", "outputs", "size", "hfov_deg", "baseline_m", "seed"])]
    add: Option<u32>,
    /// Folder of your own vehicles and props: `vehicles/*.glb` or `*.gltf`, `props/*.glb`, and what
    /// there is to say about them in `assets.toml`; datasets/README.md explains it. With `--add`,
    /// where the dataset's assets are now
    #[arg(long, value_name = "DIR")]
    assets: Option<PathBuf>,
    /// Size of the images, pixels
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    size: Option<ImageSize>,
    /// Horizontal field of view of both cameras, degrees, 10 to 140
    #[arg(long, value_name = "DEG")]
    hfov_deg: Option<f64>,
    /// Distance between the cameras, metres, 0.01 to 5
    #[arg(long, value_name = "M")]
    baseline_m: Option<f64>,
    /// Everything random follows from it
    #[arg(long)]
    seed: Option<u64>,
    /// Folder of the dataset; created where it is missing [default: datasets/ and the name of the
    /// preset or configuration]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  A small dataset in `datasets/quick`:

    twinsight generate --preset quick --out datasets/quick

  The paper's dataset, smaller:

    twinsight generate --preset paper --frames 1000 --size 1024x576 --out datasets/half

  Training data for your own cameras, without test frames:

    twinsight generate --size 1280x720 --hfov-deg 70 --baseline-m 0.12 --no-test --out datasets/mine

  Six vehicles in a scene, with depth and instance maps:

    twinsight generate --vehicles 6 --outputs depth,instances --out datasets/maps

  With your own cars, buses and bus stops from glTF files:

    twinsight generate --assets my-assets --out datasets/mine

  1000 more frames for a dataset:

    twinsight generate --add 1000 --out datasets/quick

  Your own settings; `datasets/quick.toml` shows and explains every one:

    twinsight generate --config my.toml --out datasets/mine";

/// Names of the extra outputs.
const OUTPUTS: [&str; 4] = ["depth", "disparity", "instances", "poses"];

/// A number, or a range such as `4-8`.
fn vehicles(text: &str) -> Result<VehicleCount, String> {
    let (least, most) = text.split_once('-').unwrap_or((text, text));
    match (least.parse(), most.parse()) {
        (Ok(least), Ok(most)) => Ok(VehicleCount { least, most }),
        _ => Err("is no number of vehicles; write it like 4 or 4-8".to_owned()),
    }
}

impl GenerateArgs {
    /// Makes the dataset.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let out = self.out();
        let report = if let Some(frames) = self.add {
            let assets = self.assets.as_deref();
            terminal::with_progress(quiet, |progress| add_frames(frames, &out, assets, progress))?
        } else {
            let config = self.resolve()?;
            terminal::with_progress(quiet, |progress| generate(&config, &out, progress))?
        };
        stdout::print(&format!("{}\n", summary(&report, &out)))
    }

    fn resolve(&self) -> Result<GenerateConfig> {
        let mut config = match &self.config {
            // Checked below: a body of the file may come from the folder of --assets.
            Some(path) => GenerateConfig::unchecked_from_toml_file(path)?,
            None => GenerateConfig::preset(&self.preset)?,
        };
        if let Some(frames) = self.frames {
            config.frames = frames;
        }
        if let Some(vehicles) = self.vehicles {
            config.vehicles = vehicles;
        }
        for output in &self.outputs {
            match output.as_str() {
                "depth" => config.outputs.depth = true,
                "disparity" => config.outputs.disparity = true,
                "instances" => config.outputs.instances = true,
                _ => config.outputs.poses = true,
            }
        }
        if let Some(folder) = &self.assets {
            match &mut config.assets {
                Some(assets) => assets.folder.clone_from(folder),
                none => *none = Some(Assets::of(folder.clone())),
            }
        }
        if let Some(size) = self.size {
            config.width = size.width;
            config.height = size.height;
        }
        if let Some(hfov_deg) = self.hfov_deg {
            config.hfov_deg = hfov_deg;
        }
        if let Some(baseline_m) = self.baseline_m {
            config.baseline_m = baseline_m;
        }
        if self.no_test {
            config.test = None;
        }
        if let Some(seed) = self.seed {
            config.seed = seed;
        }
        config.validate()?;
        Ok(config)
    }

    fn out(&self) -> PathBuf {
        match &self.out {
            Some(out) => out.clone(),
            None => {
                Path::new("datasets").join(presets::title(&self.preset, self.config.as_deref()))
            }
        }
    }
}

/// What was made and where it is, in a line.
pub fn summary(report: &GenerateReport, out: &Path) -> String {
    let GenerateReport {
        frames,
        reused,
        train,
        val,
        test,
    } = report;
    let kept = match reused {
        0 => String::new(),
        reused => format!(", {reused} of them kept from earlier"),
    };
    let out = out.display();
    format!("dataset {out}: {frames} frames ({train} train, {val} val, {test} test){kept}")
}
