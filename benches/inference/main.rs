//! How fast everything is: kernels, networks, a stereo pair from files to metres, training, data.
//!
//! `cargo bench` runs every section, `cargo bench -- layers pair` those whose names contain one of
//! the words:
//!
//! | section | what it measures |
//! |---|---|
//! | `machine` | threads, vectors, and the rate of a matrix product: what the others are shares of |
//! | `layers` | every convolution of both networks alone |
//! | `networks` | both networks, from input tensor to result |
//! | `pair` | a 2048x1080 stereo pair to metres, and how the cost grows |
//! | `training` | optimiser steps, with our kernels and with Burn's own operations |
//! | `loader` | augmented training images and composites |
//! | `renderer` | rendered stereo pairs |
//! | `memory` | peak of inference, and growth over a thousand runs |
//!
//! Tables go to standard output. With `TWINSIGHT_BENCH_TSV` set to a file it also writes lines
//! `case<TAB>milliseconds` (minimum over the runs). `TWINSIGHT_BENCH_DEVICE` chooses the device.
//! All sections together take about five minutes on two cores.
//! Weights are fresh: speed does not depend on their values. Nothing is asserted about times.
//!
//! Shared machines change their speed from second to second, so rates are also given as shares of
//! the matrix product's rate measured right before.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a benchmark reports on standard output, and its misuse on standard error"
)]

mod child;
mod composed;
mod data;
mod layers;
mod machine;
mod memory;
mod networks;
mod pair;
mod report;
mod scene;
mod training;

use std::path::PathBuf;
use std::process::ExitCode;

use burn::tensor::Device;
use twinsight::device::DeviceName;
use twinsight::{Result, files};

use machine::Machine;
use report::Report;

/// What every section works with.
pub struct Bench {
    device: Device,
    machine: Machine,
    report: Report,
}

/// A part of the benchmark that can be asked for by name.
struct Section {
    name: &'static str,
    run: fn(&mut Bench) -> Result<()>,
}

const SECTIONS: [Section; 8] = [
    Section {
        name: "machine",
        run: machine::run,
    },
    Section {
        name: "layers",
        run: layers::run,
    },
    Section {
        name: "networks",
        run: networks::run,
    },
    Section {
        name: "pair",
        run: pair::run,
    },
    Section {
        name: "training",
        run: training::run,
    },
    Section {
        name: "loader",
        run: data::run_loader,
    },
    Section {
        name: "renderer",
        run: data::run_renderer,
    },
    Section {
        name: "memory",
        run: memory::run,
    },
];

/// The sections whose names contain one of the words, all of them without words.
fn chosen(words: &[String]) -> std::result::Result<Vec<&'static Section>, String> {
    let names = SECTIONS.each_ref().map(|section| section.name);
    for word in words {
        if !names.iter().any(|name| name.contains(word.as_str())) {
            return Err(format!(
                "'{word}' is part of no section's name; the sections are {}",
                names.join(", ")
            ));
        }
    }
    let is_chosen = |section: &&Section| {
        words.is_empty()
            || words
                .iter()
                .any(|word| section.name.contains(word.as_str()))
    };
    Ok(SECTIONS.iter().filter(is_chosen).collect())
}

fn main() -> ExitCode {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    // `cargo bench` passes `--bench`; `cargo test` runs bench targets without it.
    let Some(flag) = arguments
        .iter()
        .position(|argument| argument == "--bench" || argument == child::FLAG)
    else {
        return ExitCode::SUCCESS;
    };
    let is_child = arguments.remove(flag) == child::FLAG;
    twinsight::kernels::keep_freed_memory();
    let outcome = if is_child {
        child::serve(&arguments)
    } else {
        match chosen(&arguments) {
            Ok(sections) => run(&sections),
            Err(problem) => {
                eprintln!("error: {problem}");
                return ExitCode::from(2);
            }
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// The device that the environment names.
fn open_device() -> Result<(String, Device)> {
    let name = std::env::var("TWINSIGHT_BENCH_DEVICE").unwrap_or_else(|_| "flex".to_owned());
    let device = name.parse::<DeviceName>()?.open()?;
    Ok((name, device))
}

fn run(sections: &[&Section]) -> Result<()> {
    let (name, device) = open_device()?;
    println!("device {name}, {} threads", rayon::current_num_threads());
    let mut bench = Bench {
        machine: Machine::new(&device),
        device,
        report: Report::default(),
    };
    for section in sections {
        println!("\n== {}", section.name);
        (section.run)(&mut bench)?;
    }
    if let Some(path) = std::env::var_os("TWINSIGHT_BENCH_TSV") {
        files::write_atomically(PathBuf::from(path), bench.report.lines().as_bytes())?;
    }
    Ok(())
}
