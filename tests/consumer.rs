//! The library in another crate: a program of ten lines, built and run as its user would.
#![allow(clippy::unwrap_used, reason = "a test stops at whatever is unexpected")]

#[path = "support/untrained.rs"]
mod untrained;

use std::path::Path;
use std::process::{Command, Output};

use untrained::{texture, write_run};

/// Beginnings of the variables that cargo sets for the tests of one package.
const OF_THIS_PACKAGE: [&str; 9] = [
    "CARGO_PKG_",
    "CARGO_MANIFEST_",
    "CARGO_BIN_",
    "CARGO_CRATE_",
    "CARGO_CFG_",
    "CARGO_PRIMARY_PACKAGE",
    "CARGO_TARGET_TMPDIR",
    "CARGO_RUSTC_CURRENT_DIR",
    "OUT_DIR",
];

/// Builds the program with the features and the profile of this build, so that only the program
/// itself is compiled.
fn build() -> std::path::PathBuf {
    let profile = Path::new(env!("CARGO_BIN_EXE_twinsight")).parent().unwrap();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let features: Vec<&str> = [
        ("twinsight/ndarray", cfg!(feature = "ndarray")),
        ("twinsight/wgpu", cfg!(feature = "wgpu")),
        ("twinsight/cuda", cfg!(feature = "cuda")),
        ("twinsight/remote", cfg!(feature = "remote")),
    ]
    .iter()
    .filter_map(|(feature, is_on)| is_on.then_some(*feature))
    .collect();
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        .current_dir(root)
        .args(["build", "--offline", "--package", "twinsight-consumer"])
        .args(["--features", &features.join(",")])
        .arg("--target-dir")
        .arg(profile.parent().unwrap());
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    // What the running cargo says of this package is not said of the other one, and build scripts
    // that look at it would start afresh.
    for (name, _) in std::env::vars_os() {
        let text = name.to_string_lossy();
        if OF_THIS_PACKAGE
            .iter()
            .any(|prefix| text.starts_with(prefix))
        {
            cargo.env_remove(name);
        }
    }
    let output = cargo.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let is_rebuilt = said.contains("Compiling burn v");
    assert!(!is_rebuilt, "features or profile differ: {said}");
    profile.join(format!(
        "twinsight-consumer{}",
        std::env::consts::EXE_SUFFIX
    ))
}

fn run(program: &Path, folder: &Path, args: [&str; 3]) -> Output {
    Command::new(program)
        .current_dir(folder)
        .args(args)
        .output()
        .unwrap()
}

#[test]
fn another_crate_measures_a_pair_in_ten_lines() {
    let folder = tempfile::tempdir().unwrap();
    write_run(&folder.path().join("run"), 64);
    for (name, shift) in [("left.png", 0), ("right.png", 2)] {
        let image = texture(64, 36, 1, shift);
        twinsight::imaging::save_png(folder.path().join(name), &image).unwrap();
    }
    let program = build();
    let output = run(&program, folder.path(), ["run", "left.png", "right.png"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    // Networks that never learnt are not sure of anything; the library itself says nothing.
    assert_eq!((&*output.stdout, &*said), (&b""[..], ""));

    // Errors are values that say what to do.
    let output = run(&program, folder.path(), ["run", "left.png", "nowhere.png"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        !output.status.success() && said.contains("nowhere.png"),
        "{said}"
    );
}
