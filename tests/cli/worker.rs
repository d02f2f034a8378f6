//! Computing through a worker of this machine.

use std::io::{BufRead as _, BufReader, Lines};
use std::net::UdpSocket;
use std::process::{Child, ChildStdout, Stdio};

use super::{TINY_TRAINING, Workplace, with_dataset};

const TOKEN: (&str, &str) = ("TWINSIGHT_TOKEN", "a-token-of-the-tests");

/// A worker that ends with the test.
struct Serving {
    process: Child,
    address: String,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Serving {
    fn start(place: &Workplace) -> Self {
        // Free a moment ago; nothing else on this machine asks for it by number.
        let socket = UdpSocket::bind("0.0.0.0:0").unwrap();
        let port = socket.local_addr().unwrap().port();
        drop(socket);
        let mut process = place
            .command()
            .args(["worker", "--port", &port.to_string()])
            .env(TOKEN.0, TOKEN.1)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let address = lines.next().unwrap().unwrap();
        Self {
            process,
            address,
            lines,
        }
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn losses(place: &Workplace, run: &str) -> Vec<f64> {
    let mut rows = csv::Reader::from_path(place.path(format!("{run}/metrics.csv"))).unwrap();
    let headers = rows.headers().unwrap().clone();
    let columns = ["loss", "gradient_norm"]
        .map(|name| headers.iter().position(|header| header == name).unwrap());
    rows.records()
        .flat_map(|row| {
            let row = row.unwrap();
            columns.map(|column| row[column].parse().unwrap())
        })
        .collect()
}

#[test]
fn training_on_a_worker_is_training_here() {
    let place = with_dataset();
    // Its first weights are drawn on the device, and cannot be given.
    let settings = format!("{TINY_TRAINING}[size]\nepochs = 0\n");
    place.write("training.toml", settings);
    let train = "train --config training.toml --data data";
    place.line(&format!("{train} --run start")).success();
    // First weights are drawn on the device, so both go on from the same ones.
    let from = format!(
        // Adam's first steps are as long for rounding as for gradients: small ones keep both alike.
        "{train} --learning-rate 0.0001 --weights start/detector/last.safetensors \
         --distance-weights start/distance/last.safetensors"
    );
    place.line(&format!("{from} --run here")).success();
    let worker = Serving::start(&place);
    let there = format!("{from} --run there --device {}", worker.address);
    place.line_with(&there, TOKEN).success();
    let (here, there) = (losses(&place, "here"), losses(&place, "there"));
    assert_eq!(here.len(), 4);
    for (here, there) in here.iter().zip(&there) {
        // The worker composes what the kernels here do in one piece: 32-bit sums in another order.
        assert!(
            (there / here - 1.0).abs() < 1e-2,
            "{there} there, {here} here"
        );
    }
}

#[test]
fn the_log_of_a_worker_has_no_colours_where_nobody_sees_them() {
    let place = Workplace::new();
    let mut worker = Serving::start(&place);
    let log = worker.lines.find_map(|line| {
        let line = line.unwrap();
        line.contains("INFO").then_some(line)
    });
    let log = log.unwrap();
    assert!(!log.contains('\u{1b}'), "{log:?}");
}

#[test]
fn a_worker_lets_in_only_who_knows_the_token() {
    let place = with_dataset();
    let worker = Serving::start(&place);
    let line = format!("train --data data --run r --device {}", worker.address);
    place
        .line_with(&line, (TOKEN.0, "another-token-than-that"))
        .error_says(&[&worker.address, "credential", "token"]);
    place
        .line_with(&line, (TOKEN.0, ""))
        .error_says(&["TWINSIGHT_TOKEN", "openssl rand"]);
    place
        .line("worker --port 1")
        .error_says(&["TWINSIGHT_TOKEN"]);
    place
        .line_with(
            "train --data data --run r --device remote:nobody@127.0.0.1:1",
            TOKEN,
        )
        .error_says(&["nobody", "is not a worker's ID"]);
    place
        .line_with("train --data data --run r --device remote:nobody", TOKEN)
        .error_says(&["remote:nobody", "remote:ID@HOST:PORT"]);
}
