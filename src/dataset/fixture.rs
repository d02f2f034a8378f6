//! A small sound dataset in a temporary folder, for tests to read and to spoil.

use std::fs;
use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use tempfile::TempDir;

use super::{
    BoxKind, FrameRow, Label, Split, StereoDataset, View, label_file_text, write_frames_csv,
};
use crate::geometry::PixelBox;
use crate::imaging::save_png;

pub(crate) const WIDTH: u32 = 96;
pub(crate) const HEIGHT: u32 = 54;

pub(crate) struct Fixture {
    folder: TempDir,
}

impl Fixture {
    /// Frames 1 to `count`; the fourth of each five validates and the fifth tests; one vehicle
    /// each, with both kinds of label.
    pub(crate) fn new(count: u64) -> Self {
        let fixture = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        fs::create_dir(fixture.path("frames")).unwrap();
        fs::write(
            fixture.path("dataset.toml"),
            format!(
                "version = 1\nclasses = [\"car\"]\nlabel_kinds = [\"sphere\", \"tight\"]\n\
                 [rig]\nwidth = {WIDTH}\nheight = {HEIGHT}\nhfov_deg = 90.0\nbaseline_m = 0.8\n\
                 [made_by]\nseed = 7\n"
            ),
        )
        .unwrap();
        let rows: Vec<_> = (1..=count).map(row).collect();
        write_frames_csv(fixture.path("frames.csv"), &rows).unwrap();
        for stamp in 1..=count {
            for side in ["left", "right"] {
                let labels = labels(stamp, side);
                fixture.write(
                    &format!("frames/{side}_{stamp:05}.txt"),
                    &label_file_text(&labels),
                );
                let image = fixture.path(&format!("frames/{side}_{stamp:05}.png"));
                save_png(image, &picture(stamp, side)).unwrap();
            }
        }
        fixture
    }

    /// The same with two vehicles a frame whose labels obey the rig, and every frame a scene of its
    /// own; the second vehicle is ignored in every third frame.
    pub(crate) fn lawful(count: u64) -> Self {
        let fixture = Self::new(count);
        let rig = *fixture.open().rig();
        let mut rows = Vec::new();
        for stamp in 1..=count {
            let mut sides = [Vec::new(), Vec::new()];
            let mut first_m = 0.0;
            for id in 0..2_u32 {
                let center = [
                    f64::from(id) * 5.0 - 2.0,
                    1.0,
                    8.0 + stamp as f64 + 3.0 * f64::from(id),
                ];
                let distance_m = center.map(|v| v * v).iter().sum::<f64>().sqrt();
                if id == 0 {
                    first_m = distance_m;
                }
                let pixels = rig.pixels_from_rig(center).unwrap();
                for (side, pixel) in sides.iter_mut().zip(pixels) {
                    let size = 48.0 * 3.0 / center[2];
                    for (kind, width, height) in [
                        (BoxKind::Sphere, size, size),
                        (BoxKind::Tight, size * 0.8, size * 0.4),
                    ] {
                        side.push(Label {
                            id,
                            class: 0,
                            box_pixel: PixelBox::from_center(pixel, width, height),
                            center_pixel: pixel,
                            distance_m: Some(distance_m),
                            kind,
                            visible: Some(0.75),
                            ignored: id == 1 && stamp % 3 == 0,
                        });
                    }
                }
            }
            for (side, labels) in ["left", "right"].iter().zip(&sides) {
                fixture.write(
                    &format!("frames/{side}_{stamp:05}.txt"),
                    &label_file_text(labels),
                );
            }
            rows.push(FrameRow {
                scene: Some(stamp as u32),
                view: None,
                distance_m: Some(first_m),
                ..row(stamp)
            });
        }
        write_frames_csv(fixture.path("frames.csv"), &rows).unwrap();
        fixture
    }

    pub(crate) fn root(&self) -> &Path {
        self.folder.path()
    }

    pub(crate) fn path(&self, relative: &str) -> PathBuf {
        self.folder.path().join(relative)
    }

    pub(crate) fn write(&self, relative: &str, text: &str) {
        fs::write(self.path(relative), text).unwrap();
    }

    /// Replaces text in a file, which must hold it.
    pub(crate) fn edit(&self, relative: &str, from: &str, to: &str) {
        let text = fs::read_to_string(self.path(relative)).unwrap();
        assert!(text.contains(from), "{relative} should hold {from}: {text}");
        self.write(relative, &text.replace(from, to));
    }

    pub(crate) fn remove(&self, relative: &str) {
        fs::remove_file(self.path(relative)).unwrap();
    }

    pub(crate) fn open(&self) -> StereoDataset {
        StereoDataset::open(self.root()).unwrap()
    }

    /// The message of a dataset that cannot be opened.
    pub(crate) fn refusal(&self) -> String {
        StereoDataset::open(self.root()).unwrap_err().to_string()
    }
}

pub(crate) fn row(stamp: u64) -> FrameRow {
    FrameRow {
        stamp,
        split: match stamp % 5 {
            4 => Split::Val,
            0 => Split::Test,
            _ => Split::Train,
        },
        scene: Some(stamp as u32 / 2),
        sun: Some("noon".to_owned()),
        view: Some(View::Side),
        azimuth_deg: Some(17.5 * stamp as f64),
        elevation_deg: None,
        distance_m: Some(10.0 + stamp as f64),
    }
}

fn labels(stamp: u64, side: &str) -> Vec<Label> {
    let x = 20.0 + stamp as f64 + if side == "left" { 4.0 } else { 0.0 };
    [
        (BoxKind::Sphere, PixelBox::new(x, 10.0, x + 30.0, 40.0)),
        (BoxKind::Tight, PixelBox::new(x + 2.0, 18.0, x + 28.0, 34.0)),
    ]
    .map(|(kind, box_pixel)| Label {
        id: 3,
        class: 0,
        box_pixel,
        center_pixel: box_pixel.center(),
        distance_m: Some(10.0 + stamp as f64),
        kind,
        visible: Some(0.75),
        ignored: false,
    })
    .to_vec()
}

pub(crate) fn picture(stamp: u64, side: &str) -> RgbImage {
    let shift = stamp as u32 * 7 + u32::from(side == "left") * 3;
    RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
        Rgb([
            ((x + shift) * 5) as u8,
            (y * 4 + shift) as u8,
            ((x * y) / 8 + shift) as u8,
        ])
    })
}
