//! `twinsight devices`.

use std::fmt::Write as _;

use clap::Args;
use twinsight::Result;
use twinsight::device::{DeviceReport, devices};

use super::stdout;

/// List what this program can compute on here, and how to enable the rest
///
/// A device has to be built into the program, and the machine has to have it. What is printed in
/// the first column is what --device takes.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct DevicesArgs {}

const EXAMPLES: &str = "\
Examples:
  Look what there is, then train on the second graphics card:

    twinsight devices
    twinsight train --device wgpu:1";

impl DevicesArgs {
    /// Lists the devices.
    pub fn run() -> Result<()> {
        stdout::print(&table(&devices()))
    }
}

/// A block of lines for each kind of device.
fn table(reports: &[DeviceReport]) -> String {
    let mut text = String::new();
    for report in reports {
        let state = match report.obstacle {
            None => "ready",
            Some(_) => "not available",
        };
        // Writing to a String cannot fail.
        writeln!(text, "{:<9}{state}: {}", report.name, report.about).ok();
        for (index, found) in report.found.iter().enumerate() {
            match report.found.len() {
                1 => writeln!(text, "{:<9}{found}", "").ok(),
                _ => writeln!(text, "{:<9}{}:{index} {found}", "", report.name).ok(),
            };
        }
        if let Some(obstacle) = &report.obstacle {
            writeln!(text, "{:<9}{obstacle}", "").ok();
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_cards_are_listed_with_the_names_to_type() {
        let report = DeviceReport {
            name: "wgpu".to_owned(),
            about: "graphics card",
            obstacle: None,
            found: vec!["A".to_owned(), "B".to_owned()],
        };
        let text = table(&[report]);
        assert_eq!(
            text,
            "wgpu     ready: graphics card\n         wgpu:0 A\n         wgpu:1 B\n"
        );
    }

    #[test]
    fn an_obstacle_is_told() {
        let report = DeviceReport {
            name: "cuda".to_owned(),
            about: "NVIDIA graphics card",
            obstacle: Some("not in this build".to_owned()),
            found: Vec::new(),
        };
        let text = table(&[report]);
        assert!(text.contains("cuda     not available") && text.contains("not in this build"));
    }
}
