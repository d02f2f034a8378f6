//! Where the results of `predict` go.

use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use image::RgbImage;
use serde::Serialize;
use twinsight::pipeline::{Findings, Unmatched, Vehicle};
use twinsight::predict::{
    AnnotatedVideo, CsvFile, FrameRecord, JsonLines, Outcome, PictureFolder, Sink, picture,
};
use twinsight::sources::VideoEncoding;
use twinsight::{Error, Result, imaging};

use super::super::files::{self, Kind, check_folder, check_target};
use super::super::stdout;

/// Frames a second of a video that was made of images.
const DEFAULT_RATE_HZ: f64 = 10.0;

/// What errors call standard output.
const STDOUT: &str = "standard output";

/// What was asked for.
#[derive(Debug, Clone, Copy)]
pub struct Outputs<'a> {
    pub jsonl: Option<&'a Path>,
    pub csv: Option<&'a Path>,
    pub annotate: Option<&'a Path>,
    pub video: Option<&'a Path>,
    pub rate_hz: Option<f64>,
}

/// What is printed of one pair.
#[derive(Debug, Serialize)]
struct Prediction {
    left: String,
    right: String,
    vehicles: Vec<Vehicle>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    without_distance: Vec<Unmatched>,
}

/// Which text goes to standard output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Printed {
    Json,
    JsonLines,
    Csv,
    Nothing,
}

impl Outputs<'_> {
    /// Refuses what contradicts itself.
    pub fn check_names(&self) -> Result<()> {
        if is_stdout(self.jsonl) && is_stdout(self.csv) {
            return Err(Error::value(
                "--jsonl - and --csv -",
                "both want standard output",
                "give one of them a file",
            ));
        }
        let targets = [self.jsonl, self.csv, self.annotate, self.video];
        for (i, target) in targets.iter().enumerate() {
            let Some(target) = target.filter(|path| !is_stdout(Some(path))) else {
                continue;
            };
            let mut others = targets[..i].iter().flatten();
            if others.any(|other| files::is_same(other, target)) {
                return Err(Error::value(
                    target.display().to_string(),
                    "is to hold two kinds of results",
                    "give each its own file",
                ));
            }
        }
        Ok(())
    }

    /// Makes sure before the work that all files can be written, and replace none of these files nor
    /// those in these folders.
    pub fn check_targets(
        &self,
        is_one: bool,
        inputs: &[PathBuf],
        folders: &[PathBuf],
    ) -> Result<()> {
        let texts = [(self.jsonl, Kind::JSON_LINES), (self.csv, Kind::CSV)];
        let texts = texts.into_iter().filter(|(path, _)| !is_stdout(*path));
        for (path, kind) in texts.chain([(self.video, Kind::VIDEO)]) {
            if let Some(path) = path {
                check_target(path, kind, inputs)?;
            }
        }
        match self.annotate {
            Some(path) if is_one => {
                check_target(path, Kind::PICTURE, inputs)?;
                check_picture(path)
            }
            Some(path) => check_folder(path, folders),
            None => Ok(()),
        }
    }

    fn printed(&self, is_one: bool) -> Printed {
        if is_stdout(self.csv) {
            Printed::Csv
        } else if is_stdout(self.jsonl) {
            Printed::JsonLines
        } else if self.jsonl.is_some() {
            Printed::Nothing
        } else if is_one {
            Printed::Json
        } else {
            Printed::JsonLines
        }
    }

    /// Everything that takes results, for many frames.
    pub fn sinks(&self, source_rate_hz: Option<f64>) -> Result<Vec<Box<dyn Sink>>> {
        let mut sinks = self.file_sinks(source_rate_hz)?;
        let is_only = sinks.is_empty();
        sinks.extend(Self::printing(self.printed(false), is_only));
        Ok(sinks)
    }

    /// What prints frame after frame.
    fn printing(printed: Printed, is_only: bool) -> Option<Box<dyn Sink>> {
        let is_by_frame = matches!(printed, Printed::JsonLines | Printed::Csv);
        is_by_frame.then(|| -> Box<dyn Sink> {
            Box::new(StandardOutput {
                printed,
                is_only,
                is_begun: false,
                is_closed: false,
            })
        })
    }

    fn file_sinks(&self, source_rate_hz: Option<f64>) -> Result<Vec<Box<dyn Sink>>> {
        let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
        if let Some(path) = self.jsonl.filter(|path| !is_stdout(Some(path))) {
            sinks.push(Box::new(JsonLines::create(path)?));
        }
        if let Some(path) = self.csv.filter(|path| !is_stdout(Some(path))) {
            sinks.push(Box::new(CsvFile::create(path)?));
        }
        if let Some(folder) = self.annotate {
            sinks.push(Box::new(PictureFolder::create(folder)?));
        }
        if let Some(path) = self.video {
            let rate_hz = self.rate_hz.or(source_rate_hz).unwrap_or(DEFAULT_RATE_HZ);
            sinks.push(Box::new(AnnotatedVideo::create(
                path,
                VideoEncoding { rate_hz },
            )?));
        }
        Ok(sinks)
    }

    /// Writes the results of one pair.
    pub fn write_one(
        &self,
        frame: &str,
        [left, right]: [String; 2],
        images: [&RgbImage; 2],
        found: Findings,
    ) -> Result<()> {
        let record = FrameRecord {
            frame: frame.to_owned(),
            left,
            right,
            time_s: None,
            outcome: Outcome::Measured {
                vehicles: found.vehicles,
                without_distance: found.unmatched,
            },
        };
        if let Some(path) = self.annotate {
            let picture = picture(images, &record.outcome);
            let is_jpeg = Kind::PICTURE.ends(path) && !is_png(path);
            let bytes = if is_jpeg {
                imaging::jpeg_bytes(path, &picture)
            } else {
                imaging::png_bytes(path, &picture)
            };
            files::write(path, &bytes?)?;
        }
        let others = Self {
            annotate: None,
            ..*self
        };
        let printed = others.printed(true);
        let printing = Self::printing(printed, false);
        for mut sink in others.file_sinks(None)?.into_iter().chain(printing) {
            sink.take(&record, Some(images))?;
            sink.finish()?;
        }
        if printed != Printed::Json {
            return Ok(());
        }
        let prediction = Prediction {
            vehicles: record.outcome.vehicles().to_vec(),
            without_distance: record.outcome.without_distance().to_vec(),
            left: record.left,
            right: record.right,
        };
        let json = serde_json::to_string_pretty(&prediction)
            .map_err(|error| Error::io("write", STDOUT)(error.into()))?;
        stdout::print(&format!("{json}\n"))
    }
}

/// Refuses a name that does not say in which format a picture is to be written; a device is given a
/// PNG.
fn check_picture(path: &Path) -> Result<()> {
    let is_device = path.exists() && !path.is_file();
    if is_device || Kind::PICTURE.ends(path) {
        return Ok(());
    }
    Err(Error::value(
        path.display().to_string(),
        "is not the name of a picture that can be written",
        "let it end in .png or .jpg",
    ))
}

fn is_png(path: &Path) -> bool {
    let ending = path.extension();
    ending.is_some_and(|ending| ending.eq_ignore_ascii_case("png"))
}

/// Whether a target is standard output.
fn is_stdout(path: Option<&Path>) -> bool {
    path.is_some_and(|path| path.as_os_str() == "-")
}

/// Whether an error is that of a reader of standard output that has seen enough, such as `head`.
pub fn is_closed_pipe(error: &Error) -> bool {
    matches!(error, Error::Io { path, source, .. }
        if path.as_os_str() == STDOUT && source.kind() == ErrorKind::BrokenPipe)
}

/// Prints frame after frame.
struct StandardOutput {
    printed: Printed,
    /// Nothing else is written: without a reader the work is pointless.
    is_only: bool,
    is_begun: bool,
    is_closed: bool,
}

impl StandardOutput {
    fn print(&mut self, text: &str) -> Result<()> {
        if self.is_closed {
            return Ok(());
        }
        let mut stdout = io::stdout().lock();
        let printed = stdout
            .write_all(text.as_bytes())
            .and_then(|()| stdout.flush());
        match printed {
            Err(error) if error.kind() == ErrorKind::BrokenPipe && !self.is_only => {
                self.is_closed = true;
                Ok(())
            }
            printed => printed.map_err(Error::io("write", STDOUT)),
        }
    }

    fn header(&mut self) -> Result<()> {
        if self.printed == Printed::Csv && !self.is_begun {
            self.is_begun = true;
            self.print(&CsvFile::header())?;
        }
        Ok(())
    }
}

impl Sink for StandardOutput {
    fn take(&mut self, record: &FrameRecord, _: Option<[&RgbImage; 2]>) -> Result<()> {
        self.header()?;
        let text = match self.printed {
            Printed::Csv => CsvFile::rows(record)?,
            _ => record.to_line()?,
        };
        self.print(&text)
    }

    fn finish(mut self: Box<Self>) -> Result<()> {
        self.header()
    }
}
