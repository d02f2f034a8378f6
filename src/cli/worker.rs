//! `twinsight worker`.

use std::path::PathBuf;

use clap::Args;
use twinsight::Result;
use twinsight::device::DeviceName;
use twinsight::worker::{PORT, TOKEN_VARIABLE, Worker, WorkerConfig};

use super::stdout;

/// Let other machines compute on this one's devices
///
/// Prints the address to give as `--device` there, and serves until Ctrl-C. Clients must present the
/// token in the environment variable `TWINSIGHT_TOKEN`, which both sides need; the connection is
/// encrypted and goes straight to this machine's UDP port.
#[derive(Debug, Args)]
#[command(after_long_help = EXAMPLES)]
pub struct WorkerArgs {
    /// What to serve: one device, or several of one kind, separated by commas
    #[arg(long, value_delimiter = ',', default_value = "flex")]
    device: Vec<DeviceName>,
    /// UDP port to listen on
    #[arg(long, default_value_t = PORT, value_parser = clap::value_parser!(u16).range(1..))]
    port: u16,
    /// File with the key behind this worker's ID, made where it is missing; without it the ID, and
    /// so the address, is another one at every start
    #[arg(long, value_name = "FILE")]
    identity: Option<PathBuf>,
}

const EXAMPLES: &str = "\
Examples:
  On the machine with the graphics card:

    export TWINSIGHT_TOKEN=$(openssl rand -hex 16)
    twinsight worker --device cuda --identity worker.key

  On the machine with the data, with the same token and the address that the worker printed:

    export TWINSIGHT_TOKEN=...
    twinsight train --device remote:ID@HOST:7411";

impl WorkerArgs {
    /// Serves until interrupted.
    pub fn run(&self) -> Result<()> {
        let worker = Worker::new(&WorkerConfig {
            devices: self.device.clone(),
            port: self.port,
            identity: self.identity.clone(),
            token: std::env::var(TOKEN_VARIABLE).unwrap_or_default(),
        })?;
        stdout::print(&format!(
            "{}\nOn other machines give this one's name or address for 127.0.0.1. Ctrl-C ends it.\n",
            worker.address("127.0.0.1")
        ))?;
        worker.serve()
    }
}
