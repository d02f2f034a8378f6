//! Memory of inference: its peak, and whether it grows.

use burn::tensor::Device;
use twinsight::Result;
use twinsight::detector::Scale;
use twinsight::detector::nms::NmsConfig;

use super::Bench;
use super::child::{self, Numbers};
use super::pair::PairInMemory;

/// Runs before memory is read the first time, and the last.
const SETTLED: usize = 100;
const RUNS: usize = 1000;

/// A line of this process's status, MiB.
#[cfg(target_os = "linux")]
fn status_mib(field: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

#[cfg(not(target_os = "linux"))]
fn status_mib(_: &str) -> Option<f64> {
    None
}

/// Adds the largest resident memory so far, where the system tells.
pub fn add_peak(numbers: &mut Numbers) {
    if let Some(mib) = status_mib("VmHWM") {
        numbers.insert("peak_mib".to_owned(), mib);
    }
}

fn add_resident(numbers: &mut Numbers, name: &str) {
    if let Some(mib) = status_mib("VmRSS") {
        numbers.insert(name.to_owned(), mib);
    }
}

/// A number in MiB, or that there is none.
pub fn mib_or_not(numbers: &Numbers, name: &str) -> String {
    numbers
        .get(name)
        .map_or("not measured".to_owned(), |mib| format!("{mib:.0} MiB"))
}

/// In a child: pairs with a detector of this scale.
pub fn peak(scale: &str, device: &Device) -> Result<Numbers> {
    let scale = if scale == Scale::M.letter() {
        Scale::M
    } else {
        Scale::N
    };
    let mut numbers = Numbers::new();
    add_resident(&mut numbers, "start_mib");
    let case = PairInMemory::new(scale, device)?;
    for _ in 0..3 {
        case.run()?;
    }
    add_peak(&mut numbers);
    Ok(numbers)
}

/// In a child: both networks again and again.
pub fn growth(device: &Device) -> Result<Numbers> {
    let case = PairInMemory::new(Scale::N, device)?;
    let mut numbers = Numbers::new();
    let detect = || -> Result<()> {
        let nms = NmsConfig::prediction();
        case.networks().detector.detect(&[case.image()], &nms)?;
        Ok(())
    };
    let range = || -> Result<()> {
        case.networks()
            .estimator
            .estimate(&[case.sighting()], &case.networks().rig)?;
        Ok(())
    };
    let works: [(&str, &dyn Fn() -> Result<()>); 2] = [("detector", &detect), ("distance", &range)];
    for (name, work) in works {
        for run in 1..=RUNS {
            work()?;
            if run == SETTLED || run == RUNS {
                add_resident(&mut numbers, &format!("{name}_{run}_mib"));
            }
        }
    }
    Ok(numbers)
}

/// The section `memory`.
pub fn run(_: &mut Bench) -> Result<()> {
    println!("peak resident memory of a 2048x1080 pair in memory to metres, its images included");
    for scale in [Scale::N, Scale::M] {
        let numbers = child::run(&["peak", scale.letter()])?;
        println!(
            "scale {scale}: {}, before the networks {}",
            mib_or_not(&numbers, "peak_mib"),
            mib_or_not(&numbers, "start_mib")
        );
    }
    println!("\nresident memory after {SETTLED} and after {RUNS} runs");
    let numbers = child::run(&["growth"])?;
    for name in ["detector", "distance"] {
        let [settled, last] = [SETTLED, RUNS].map(|run| format!("{name}_{run}_mib"));
        let growth = match (numbers.get(&settled), numbers.get(&last)) {
            (Some(settled), Some(last)) => format!("{:+.1} MiB", last - settled),
            _ => "not measured".to_owned(),
        };
        println!(
            "{name}: {}, {}, growth {growth}",
            mib_or_not(&numbers, &settled),
            mib_or_not(&numbers, &last)
        );
    }
    Ok(())
}
