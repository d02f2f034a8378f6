//! `twinsight train`.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use toml::{Table, Value};
use twinsight::dataset::{BoxKind, CompositeSize, Split, StereoDataset};
use twinsight::detector::Scale;
use twinsight::device::DeviceName;
use twinsight::generate::{GenerateConfig, generate};
use twinsight::progress::Progress;
use twinsight::train::{
    SavedRun, Stage, StageFolder, TrainConfig, TrainRequest, TrainSummary, plan, train,
};
use twinsight::{Error, Result, files};

use super::generate::summary as dataset_summary;
use super::values::{self, program, quoted};
use super::{presets, stdout, terminal};

/// Train the detector, the distance network, or both
///
/// Settings come from a preset, over it a configuration file, over that the options below. The run
/// folder receives the settings, the weights, checkpoints to go on from, and logs for TensorBoard.
/// Every finished epoch is saved: after Ctrl-C or a power cut --resume goes on from the last one.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct TrainArgs {
    /// What to train
    #[arg(value_enum, default_value_t = StageName::All)]
    stage: StageName,
    /// Settings that come with the program: `quick` takes minutes on a processor, `paper` is the
    /// paper's training, for a graphics card [default: quick]
    #[arg(long, value_parser = presets::names())]
    preset: Option<String>,
    /// Settings from a TOML file, over the preset; it gives only what it changes
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Folder of the dataset [default: datasets/ and the preset's name, made first where it is
    /// missing]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Folder of the run [default: checkpoints/ and the name of the configuration or preset]
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// What to compute on; `twinsight devices` lists the choices. Several, separated by commas, share
    /// every batch [default: flex]
    #[arg(long, value_delimiter = ',')]
    device: Vec<DeviceName>,
    /// Go on with a run that was stopped: with its own settings, dataset and device where they are
    /// not given
    #[arg(long)]
    resume: bool,
    /// Train nothing: print all settings as TOML, to change and give back by --config
    #[arg(long, conflicts_with_all = ["resume", "dry_run"])]
    print_config: bool,
    /// Train nothing: say how many steps, how long and how much memory it would take, measured on
    /// a few steps
    #[arg(long, conflicts_with = "resume")]
    dry_run: bool,
    #[command(flatten)]
    overrides: Overrides,
}

/// Single settings, over those of the preset and the file.
#[derive(Debug, Args)]
#[command(next_help_heading = "Settings over the preset and the configuration")]
struct Overrides {
    /// Everything random follows from it
    #[arg(long, value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    seed: Option<u64>,
    /// Size of the detector
    #[arg(long, value_enum)]
    scale: Option<Scale>,
    /// Long side of the detector's input, pixels
    #[arg(long, value_name = "PIXELS")]
    image_size: Option<u32>,
    /// Size of the distance network's input
    #[arg(long, value_name = "HEIGHTxWIDTH")]
    composite: Option<CompositeSize>,
    /// Which of a dataset's two kinds of box is learnt
    #[arg(long, value_parser = values::box_kind())]
    box_kind: Option<BoxKind>,
    /// Passes over the training data, of every network that is trained
    #[arg(long, value_name = "N")]
    epochs: Option<u32>,
    /// Passes over the training images, of the detector
    #[arg(long, value_name = "N")]
    detector_epochs: Option<u32>,
    /// Passes over the training vehicles, of the distance network
    #[arg(long, value_name = "N")]
    distance_epochs: Option<u32>,
    /// Images per optimiser step, of every network that is trained
    #[arg(long, value_name = "N")]
    batch: Option<u32>,
    /// Adam's learning rate, of every network that is trained
    #[arg(long, value_name = "RATE")]
    learning_rate: Option<f64>,
    /// Detector weights to start from: safetensors with the published names
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// Distance weights to start from: those that a training wrote
    #[arg(long, value_name = "FILE")]
    distance_weights: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  Everything at once: makes `datasets/quick` if it is missing and trains both networks on it:

    twinsight train

  The paper's training on a graphics card, into a folder of its own:

    twinsight train --preset paper --device wgpu --run checkpoints/paper-1

  Go on after Ctrl-C or a power cut:

    twinsight train --run checkpoints/paper-1 --resume

  Settings of your own: print all of them, change some, train with those:

    twinsight train --print-config > mine.toml
    twinsight train --config mine.toml

  The distance network alone, on your data:

    twinsight train distance --data datasets/mine --run checkpoints/mine --epochs 50";

/// What can be trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum StageName {
    /// Both networks, the detector first
    All,
    /// The detector: finds vehicles in an image
    Detector,
    /// The distance network, which tells the metres to a vehicle that was found, and the size network
    Distance,
}

impl StageName {
    fn stage(self) -> Stage {
        match self {
            Self::All => Stage::All,
            Self::Detector => Stage::Detector,
            Self::Distance => Stage::Distance,
        }
    }

    /// The networks' sections in the settings.
    fn sections(self) -> &'static [&'static str] {
        match self {
            Self::All => &["detector", "distance", "size"],
            Self::Detector => &["detector"],
            Self::Distance => &["distance", "size"],
        }
    }
}

/// What is to be done, once everything is settled.
struct Job {
    config: TrainConfig,
    data: PathBuf,
    run: PathBuf,
    devices: Vec<DeviceName>,
}

impl Job {
    fn request(&self, args: &TrainArgs) -> TrainRequest<'_> {
        TrainRequest {
            config: &self.config,
            data: &self.data,
            run: &self.run,
            stage: args.stage.stage(),
            resume: args.resume,
            devices: &self.devices,
        }
    }
}

impl TrainArgs {
    /// Trains.
    pub fn run(&self, quiet: bool) -> Result<()> {
        let run = self.run_folder();
        let saved = if self.resume {
            let saved = SavedRun::read(&run)?;
            if saved.is_none() && !is_hardly_begun(&run) {
                return Err(no_such_run(&run));
            }
            saved
        } else {
            None
        };
        let config = self.resolve(saved.as_ref().map(|saved| &saved.config))?;
        if self.print_config {
            return print_config(&config);
        }
        let job = Job {
            data: self.data(saved.as_ref())?,
            devices: self.devices(saved.as_ref())?,
            config,
            run,
        };
        if self.dry_run {
            return self.dry_run(quiet, &job);
        }
        self.check(&job)?;
        let is_new = self.resume && saved.is_none();
        let summary = terminal::with_progress(quiet, |progress| {
            if is_new {
                progress.note(&format!(
                    "{} holds nothing to go on with: training it from the start",
                    job.run.display()
                ));
            }
            if self.data.is_none() && saved.is_none() {
                self.make_missing_data(&job.data, progress)?;
            }
            train(&job.request(self), progress)
        })?;
        stdout::print(&self.report(&summary, &job))
    }

    /// Says what the training would take.
    fn dry_run(&self, quiet: bool, job: &Job) -> Result<()> {
        let data = &job.data;
        if self.data.is_none() && !data.join("dataset.toml").exists() {
            return Err(Error::dataset(
                data,
                "is not there yet, so its training cannot be measured",
                format!(
                    "make it first: {} generate --preset {} --out {}",
                    program(),
                    self.preset(),
                    quoted(data)
                ),
            ));
        }
        let plan = terminal::with_progress(quiet, |progress| plan(&job.request(self), progress))?;
        stdout::print(&format!("{plan}\n"))
    }

    fn preset(&self) -> &str {
        self.preset.as_deref().unwrap_or(presets::DEFAULT)
    }

    /// The settings of the preset, or of the run that goes on, the file and the options together.
    fn resolve(&self, saved: Option<&TrainConfig>) -> Result<TrainConfig> {
        let file = self.config.as_deref();
        let resolve = |flags: &Table| match saved {
            Some(saved) if self.preset.is_none() => saved.changed(file, flags),
            _ => TrainConfig::resolve(Some(self.preset()), file, flags),
        };
        let mut flags = self.overrides.table(self.stage)?;
        if let Some(batch) = self.overrides.batch {
            // A forward pass cannot hold more than a batch.
            let config = resolve(&flags)?;
            for &section in self.stage.sections() {
                set(&mut flags, section, "batch", i64::from(batch));
                let micro_batch = match section {
                    "detector" => config.detector.micro_batch,
                    "distance" => config.distance.micro_batch,
                    // The size network's passes are whole batches.
                    _ => continue,
                };
                let micro_batch = i64::try_from(micro_batch).unwrap_or(i64::MAX);
                set(
                    &mut flags,
                    section,
                    "micro_batch",
                    micro_batch.min(i64::from(batch)),
                );
            }
        }
        resolve(&flags)
    }

    fn data(&self, saved: Option<&SavedRun>) -> Result<PathBuf> {
        match (&self.data, saved) {
            (Some(data), _) => Ok(data.clone()),
            (None, Some(saved)) if saved.data.exists() => Ok(saved.data.clone()),
            (None, Some(saved)) => Err(Error::dataset(
                &saved.data,
                "is not there, on which the run was started",
                "give its folder by --data, or call from the folder where the run was started",
            )),
            (None, None) => Ok(Path::new("datasets").join(self.preset())),
        }
    }

    fn devices(&self, saved: Option<&SavedRun>) -> Result<Vec<DeviceName>> {
        match saved {
            _ if !self.device.is_empty() => Ok(self.device.clone()),
            Some(saved) => saved.devices(),
            None => Ok(vec![DeviceName::FLEX]),
        }
    }

    fn run_folder(&self) -> PathBuf {
        match &self.run {
            Some(run) => run.clone(),
            None => {
                Path::new("checkpoints").join(presets::title(self.preset(), self.config.as_deref()))
            }
        }
    }

    /// Finds out before the long work what would stop it in the end.
    fn check(&self, job: &Job) -> Result<()> {
        let (config, run) = (&job.config, &job.run);
        for stage in self.stage.sections() {
            if !self.resume && holds_anything(&run.join(stage)) {
                return Err(Error::value(
                    format!("run {}", run.display()),
                    format!("exists already and has a {stage}"),
                    "go on with it by --resume, or choose another folder by --run",
                ));
            }
        }
        for device in &job.devices {
            device.open()?;
        }
        // A network that goes on has its own.
        let given = [&config.detector.weights, &config.distance.weights];
        for weights in given.into_iter().flatten().filter(|_| !self.resume) {
            fs::File::open(weights).map_err(Error::io("read", weights))?;
        }
        files::create_folder(run)
    }

    /// Generates the preset's dataset unless it is there.
    fn make_missing_data(&self, data: &Path, progress: &dyn Progress) -> Result<()> {
        if data.join("dataset.toml").exists() {
            return Ok(());
        }
        let preset = self.preset();
        progress.note(&format!(
            "there is no dataset {}: making it first, from the preset {preset}",
            data.display()
        ));
        let report = generate(&GenerateConfig::preset(preset)?, data, progress)?;
        progress.note(&dataset_summary(&report, data));
        Ok(())
    }

    /// The figures, where things are, and what to type next.
    fn report(&self, summary: &TrainSummary, job: &Job) -> String {
        let run = &job.run;
        let missing = ["detector", "distance"]
            .into_iter()
            .find(|stage| !StageFolder::new(run, stage).best().exists());
        let next = match missing {
            // Single images show no distance.
            Some(_) if !is_stereo(&job.data) => evaluate_command(job),
            Some(stage) => self.train_command(stage, job),
            None => predict_command(job),
        };
        format!(
            "{}\n\nrun folder:   {}\nTensorBoard:  tensorboard --logdir {}\nnext command: {next}\n",
            summary.to_string().trim_end(),
            run.display(),
            quoted(run),
        )
    }

    /// The command that trains another stage into the same run with the settings that both share.
    fn train_command(&self, stage: &str, job: &Job) -> String {
        let overrides = &self.overrides;
        let devices: Vec<String> = job.devices.iter().map(ToString::to_string).collect();
        let devices = (job.devices != [DeviceName::FLEX]).then(|| devices.join(","));
        let options = [
            ("--preset", Some(self.preset().to_owned())),
            ("--config", self.config.as_deref().map(quoted)),
            ("--data", Some(quoted(&job.data))),
            ("--run", Some(quoted(&job.run))),
            ("--device", devices),
            ("--seed", overrides.seed.map(|seed| seed.to_string())),
            (
                "--box-kind",
                overrides.box_kind.map(|kind| kind.to_string()),
            ),
        ];
        let mut words = vec![program(), "train".to_owned(), stage.to_owned()];
        for (name, value) in options {
            words.extend(value.map(|value| format!("{name} {value}")));
        }
        words.join(" ")
    }
}

impl Overrides {
    /// The options as settings. The batch is missing: it depends on other settings.
    fn table(&self, stage: StageName) -> Result<Table> {
        let mut table = Table::new();
        if let Some(seed) = self.seed {
            // Limited when it was parsed.
            table.insert("seed".to_owned(), Value::Integer(seed.cast_signed()));
        }
        if let Some(kind) = self.box_kind {
            table.insert("box_kind".to_owned(), kind.to_string().into());
        }
        if let Some(scale) = self.scale {
            set(&mut table, "detector", "scale", scale.letter());
        }
        if let Some(pixels) = self.image_size {
            set(&mut table, "detector", "image_size", i64::from(pixels));
        }
        if let Some(size) = self.composite {
            let size = Value::try_from(size)
                .map_err(|error| Error::value("--composite", error.to_string(), "leave it out"))?;
            set(&mut table, "distance", "composite", size);
        }
        for &section in stage.sections() {
            if let Some(epochs) = self.epochs {
                set(&mut table, section, "epochs", i64::from(epochs));
            }
            if let Some(rate) = self.learning_rate {
                set(&mut table, section, "learning_rate", rate);
            }
        }
        for (section, epochs) in [
            ("detector", self.detector_epochs),
            ("distance", self.distance_epochs),
        ] {
            if let Some(epochs) = epochs {
                set(&mut table, section, "epochs", i64::from(epochs));
            }
        }
        for (option, section, weights) in [
            ("--weights", "detector", &self.weights),
            ("--distance-weights", "distance", &self.distance_weights),
        ] {
            let Some(weights) = weights else { continue };
            let Some(path) = weights.to_str() else {
                return Err(Error::value(
                    format!("{option} {}", weights.display()),
                    "the name is not Unicode",
                    "rename the file",
                ));
            };
            set(&mut table, section, "weights", path);
        }
        Ok(table)
    }
}

/// Puts a setting into a section, which is made where it is missing.
fn set(table: &mut Table, section: &str, key: &str, value: impl Into<Value>) {
    let section = table
        .entry(section)
        .or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(section) = section {
        section.insert(key.to_owned(), value.into());
    }
}

/// Whether a folder is that of a run which was killed before it had written its settings: there, with
/// nothing in it but its lock.
fn is_hardly_begun(run: &Path) -> bool {
    let is_lock = |entry: fs::DirEntry| entry.file_name() == "train.lock";
    fs::read_dir(run).is_ok_and(|entries| entries.flatten().all(is_lock))
}

/// Says that there is no run to go on with, and which there are beside it.
fn no_such_run(run: &Path) -> Error {
    let beside = match run.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let entries = fs::read_dir(beside).into_iter().flatten().flatten();
    let mut runs: Vec<String> = entries
        .filter(|entry| entry.path().join("config.json").is_file())
        .map(|entry| quoted(&run.with_file_name(entry.file_name())))
        .collect();
    runs.sort();
    let remedy = if runs.is_empty() {
        "check the name, or leave --resume out to start it".to_owned()
    } else {
        format!(
            "check the name (there are {}), or leave --resume out to start it",
            runs.join(", ")
        )
    };
    let problem = if run.exists() {
        "holds no run to go on with"
    } else {
        "is not there: no such run"
    };
    Error::value(format!("run {}", run.display()), problem, remedy)
}

/// A folder with anything in it.
fn holds_anything(folder: &Path) -> bool {
    fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some())
}

/// Prints settings as `--config` takes them.
fn print_config(config: &TrainConfig) -> Result<()> {
    let text = toml::to_string(config).map_err(|source| {
        Error::value(
            "the settings",
            source.to_string(),
            "report this as a defect",
        )
    })?;
    stdout::print(&text)
}

/// The command that measures the first validation frame.
fn predict_command(job: &Job) -> String {
    let [left, right] = first_validation_pair(&job.config, &job.data)
        .unwrap_or_else(|| [PathBuf::from("LEFT.png"), PathBuf::from("RIGHT.png")])
        .map(|path| quoted(&path));
    let run = quoted(&job.run);
    format!("{} predict --run {run} {left} {right}", program())
}

/// The command that shows what the run's networks can do.
fn evaluate_command(job: &Job) -> String {
    let (run, data) = (quoted(&job.run), quoted(&job.data));
    format!(
        "{} evaluate --run {run} --data {data} --split val",
        program()
    )
}

/// Whether a dataset has pairs; taken for granted where it cannot be read any more.
fn is_stereo(data: &Path) -> bool {
    StereoDataset::open(data).map_or(true, |dataset| dataset.info.stereo)
}

/// The images of the first frame that validated; none where there is none, which is no reason to
/// fail after a training that succeeded.
fn first_validation_pair(config: &TrainConfig, data: &Path) -> Option<[PathBuf; 2]> {
    let mut dataset = StereoDataset::open(data).ok()?;
    if let Some(by) = config.split {
        dataset.resplit(by, config.seed).ok()?;
    }
    let frame = *dataset.split(Split::Val).first()?;
    Some([frame.left.path.clone(), frame.right.as_ref()?.path.clone()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: TrainArgs,
    }

    fn resolve(line: &str) -> Result<TrainConfig> {
        let words = std::iter::once("train").chain(line.split_whitespace());
        Line::try_parse_from(words).unwrap().args.resolve(None)
    }

    #[test]
    fn options_go_over_the_preset() {
        let line = "--seed 9 --scale s --image-size 256 --epochs 2 --distance-epochs 5 \
                    --learning-rate 0.01 --composite 828x414 --box-kind tight --weights a.safetensors";
        let config = resolve(line).unwrap();
        assert_eq!(config.seed, 9);
        assert_eq!(config.box_kind, BoxKind::Tight);
        assert_eq!(config.detector.scale, Scale::S);
        assert_eq!(config.detector.image_size, 256);
        assert_eq!(
            config.detector.weights,
            Some(PathBuf::from("a.safetensors"))
        );
        assert_eq!((config.detector.epochs, config.distance.epochs), (2, 5));
        assert_eq!(
            (config.detector.learning_rate, config.distance.learning_rate),
            (0.01, 0.01)
        );
        assert_eq!(config.distance.composite, CompositeSize::FULL);
    }

    #[test]
    fn options_for_every_network_leave_the_one_alone_that_is_not_trained() {
        let quick = TrainConfig::preset("quick").unwrap();
        let config = resolve("distance --epochs 2 --batch 4").unwrap();
        assert_eq!(config.detector, quick.detector);
        assert_eq!((config.distance.epochs, config.distance.batch), (2, 4));
    }

    #[test]
    fn a_smaller_batch_makes_the_forward_pass_smaller_and_a_larger_one_does_not_enlarge_it() {
        let quick = TrainConfig::preset("quick").unwrap();
        let small = resolve("--batch 3").unwrap();
        assert_eq!((small.detector.batch, small.detector.micro_batch), (3, 3));
        let large = resolve("--batch 512").unwrap();
        assert_eq!(large.distance.micro_batch, quick.distance.micro_batch);
    }

    #[test]
    fn a_value_that_cannot_be_used_is_named() {
        for (line, words) in [
            ("--epochs 0", "detector.epochs = 0"),
            ("--batch 0", "detector.batch = 0"),
            ("--learning-rate NaN", "detector.learning_rate = NaN"),
        ] {
            let message = resolve(line).unwrap_err().to_string();
            assert!(message.contains(words), "{message} should contain {words}");
        }
    }
}
