//! `predict` on videos, and videos of what it sees, where the program `ffmpeg` is installed.

use std::fs;
use std::process::{Command, Stdio};

use image::RgbImage;

use super::predict::{SEES, lines, pair, save, stacked, vehicles, with_pairs};
use super::{Outcome, Workplace};

#[test]
fn without_ffmpeg_a_video_is_refused_with_the_way_to_get_it() {
    let place = with_pairs(1);
    place.write("a.mp4", "x");
    for args in [
        "a.mp4 --layout side-by-side",
        "a.mp4 a.mp4",
        "data --video seen.mp4",
    ] {
        let mut command = place.command();
        let line = format!("predict --run run {args}");
        command.args(line.split(' ')).env("PATH", "/nowhere");
        Outcome::of(command.output().unwrap()).error_says(&["not installed", "install FFmpeg"]);
    }
}

/// Where `ffmpeg` is missing, says so.
#[allow(clippy::print_stdout, reason = "a test that is skipped says so")]
fn has_ffmpeg(test: &str) -> bool {
    let found = ["ffmpeg", "ffprobe"].iter().all(|program| {
        let mut command = Command::new(program);
        command
            .arg("-version")
            .stdout(Stdio::null())
            .status()
            .is_ok()
    });
    if !found {
        println!("skipped {test}: no ffmpeg");
    }
    found
}

/// A video of the numbered pictures of a folder, with nothing lost.
fn make_video(place: &Workplace, pictures: &str, count: u32, video: &str) {
    let status = Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-framerate", "5", "-i", pictures])
        .args(["-frames:v", &count.to_string()])
        .args(["-c:v", "ffv1", "-pix_fmt", "bgr0", video])
        .current_dir(place.path(""))
        .status()
        .unwrap();
    assert!(status.success(), "{video}");
}

#[test]
fn videos_give_the_results_of_their_frames() {
    if !has_ffmpeg("videos") {
        return;
    }
    let place = with_pairs(6);
    for number in 0..6 {
        save(
            &place,
            &format!("wide/{number}.png"),
            &stacked(&pair(number), true),
        );
    }
    make_video(&place, "data/left_%05d.png", 6, "left.mkv");
    make_video(&place, "data/right_%05d.png", 6, "right.mkv");
    make_video(&place, "wide/%d.png", 6, "wide.avi");
    let run = |input: &str| place.line(&format!("{SEES} {input}")).success();
    let expected = lines(&run("data"));
    for input in ["left.mkv right.mkv", "wide.avi --layout side-by-side"] {
        let found = lines(&run(input));
        assert_eq!(vehicles(&found), vehicles(&expected), "{input}");
        assert_eq!(found[3]["frame"], "000003");
        assert!(
            (found[3]["time_s"].as_f64().unwrap() - 0.6).abs() < 1e-6,
            "{input}"
        );
    }

    // And back into a video.
    for seen in ["seen.mp4", "seen.mkv"] {
        run(&format!("left.mkv right.mkv --video {seen}"));
        let again = place.line(&format!("predict --run run {seen} --layout side-by-side"));
        let again = lines(&again.success());
        assert_eq!(again.len(), 6, "{seen}");
        assert!((again[5]["time_s"].as_f64().unwrap() - 1.0).abs() < 1e-3);
    }
    let before = fs::read(place.path("left.mkv")).unwrap();
    place
        .line("predict --run run left.mkv right.mkv --video left.mkv")
        .error_says(&["left.mkv", "is read"]);
    assert_eq!(fs::read(place.path("left.mkv")).unwrap(), before);
    run("data --video slow.avi --fps 2");
    let slow = place.line("predict --run run slow.avi --layout side-by-side");
    assert_eq!(lines(&slow.success())[2]["time_s"], 1.0);
}

#[test]
fn broken_videos_give_what_can_be_read_and_say_so() {
    if !has_ffmpeg("broken videos") {
        return;
    }
    let place = with_pairs(30);
    make_video(&place, "data/left_%05d.png", 30, "left.avi");
    make_video(&place, "data/right_%05d.png", 30, "right.avi");
    make_video(&place, "data/right_%05d.png", 20, "short.avi");
    let whole = fs::read(place.path("right.avi")).unwrap();
    place.write("cut.avi", &whole[..whole.len() * 2 / 3]);
    place.write("text.mkv", "no video");
    place.write("empty.mp4", "");

    let outcome = place.line("predict --run run left.avi short.avi");
    for words in ["short.avi", "ends after 20 frames", "left.avi goes on"] {
        assert!(
            outcome.stderr.contains(words),
            "{words}: {}",
            outcome.stderr
        );
    }
    let found = lines(&outcome.success());
    assert_eq!(found.len(), 21);
    assert!(found[19]["vehicles"].is_array() && found[20]["error"].is_string());

    let outcome = place.line("predict --run run left.avi cut.avi");
    let is_told = outcome.stderr.contains("cut.avi") && outcome.stderr.contains("ends after");
    assert!(is_told, "{}", outcome.stderr);
    let found = lines(&outcome.success());
    assert!((10..30).contains(&found.len()), "{}", found.len());
    place
        .line("predict --run run left.avi cut.avi --strict --jsonl a")
        .error_says(&["--strict"]);

    for (input, words) in [
        ("text.mkv text.mkv", &["text.mkv", "cannot be read"][..]),
        (
            "empty.mp4 --layout top-bottom",
            &["empty.mp4", "cannot be read"],
        ),
        ("nowhere.mp4 left.avi", &["nowhere.mp4", "check the path"]),
    ] {
        place
            .line(&format!("predict --run run {input}"))
            .error_says(words);
    }
    save(&place, "small/0.png", &RgbImage::new(48, 28));
    make_video(&place, "small/%d.png", 1, "small.avi");
    place
        .line("predict --run run left.avi small.avi")
        .error_says(&["64x36", "48x28"]);
}
