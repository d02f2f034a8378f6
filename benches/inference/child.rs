//! Cases in a process of their own, whose memory is then theirs alone.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};

use twinsight::{Error, Result};

use super::{memory, open_device, training};

/// Marks a child's command line.
pub const FLAG: &str = "--child";

/// What a child measured, by name.
pub type Numbers = BTreeMap<String, f64>;

fn failed(problem: impl Into<String>) -> Error {
    Error::value(
        "the benchmark's child process",
        problem,
        "run it on a machine with more memory, or leave its section out",
    )
}

/// Runs this program again with a case and waits for its numbers.
pub fn run(case: &[&str]) -> Result<Numbers> {
    let program = std::env::current_exe().map_err(|source| failed(source.to_string()))?;
    let output = Command::new(program)
        .arg(FLAG)
        .args(case)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|source| failed(source.to_string()))?;
    if !output.status.success() {
        return Err(failed(format!("{}: {}", case.join(" "), output.status)));
    }
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text
        .lines()
        .filter_map(|line| {
            let (name, value) = line.split_once('\t')?;
            Some((name.to_owned(), value.parse().ok()?))
        })
        .collect())
}

/// Measures a case in this process and prints its numbers.
pub fn serve(case: &[String]) -> Result<()> {
    let (_, device) = open_device()?;
    let words: Vec<&str> = case.iter().map(String::as_str).collect();
    let numbers = match words[..] {
        ["peak", scale] => memory::peak(scale, &device)?,
        ["growth"] => memory::growth(&device)?,
        ["training", network, operations] => training::child(network, operations, &device)?,
        _ => return Err(failed(format!("there is no case {words:?}"))),
    };
    for (name, value) in numbers {
        println!("{name}\t{value}");
    }
    Ok(())
}
