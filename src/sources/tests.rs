use std::fs;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use image::Rgb;
use tempfile::TempDir;

use super::*;
use crate::imaging::save_png;

/// A folder of small images whose colour says which they are.
struct Place(TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes images of 8x6 pixels, numbered as they come.
    fn images(&self, names: &[&str]) {
        for (number, name) in (0..).zip(names) {
            let path = self.path(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            save_png(path, &RgbImage::from_pixel(8, 6, Rgb([number, 0, 0]))).unwrap();
        }
    }

    fn open(&self, inputs: &[&str]) -> Result<FrameSource> {
        let inputs: Vec<PathBuf> = inputs.iter().map(|name| self.path(name)).collect();
        FrameSource::open(&inputs, None)
    }

    /// Name of each frame, and the numbers of its images or the reason against it.
    fn frames(&self, inputs: &[&str]) -> Vec<(String, Result<[u8; 2], String>)> {
        numbers(self.open(inputs).unwrap())
    }

    fn error(&self, inputs: &[&str]) -> String {
        self.open(inputs).unwrap_err().to_string()
    }
}

fn numbers(source: FrameSource) -> Vec<(String, Result<[u8; 2], String>)> {
    let frames = source.read_ahead(3).unwrap();
    frames
        .map(|frame| {
            let images = frame.images.map_err(|error| error.to_string());
            let numbers = images.map(|pair| pair.map(|image| image.get_pixel(0, 0).0[0]));
            (frame.name, numbers)
        })
        .collect()
}

fn good(name: &str, pair: [u8; 2]) -> (String, Result<[u8; 2], String>) {
    (name.to_owned(), Ok(pair))
}

#[test]
fn a_folder_of_both_sides_is_read_whatever_its_images_are_called() {
    let expected = [good("2", [0, 1]), good("10", [2, 3])];
    for names in [
        ["left_2.png", "right_2.png", "left_10.png", "right_10.png"],
        ["2_left.png", "2_right.png", "10_left.png", "10_right.png"],
        ["2_L.png", "2_R.png", "10_L.png", "10_R.png"],
        ["left/2.png", "right/2.png", "left/10.png", "right/10.png"],
        [
            "image_2/2.png",
            "image_3/2.png",
            "image_2/10.png",
            "image_3/10.png",
        ],
        [
            "image_02/data/2.png",
            "image_03/data/2.png",
            "image_02/data/10.png",
            "image_03/data/10.png",
        ],
        [
            "frames/left_2.png",
            "frames/right_2.png",
            "frames/left_10.png",
            "frames/right_10.png",
        ],
    ] {
        let place = Place::new();
        place.images(&names);
        assert_eq!(place.frames(&[""]), expected, "{names:?}");
    }
}

#[test]
fn two_folders_are_joined_by_name_or_else_by_order() {
    let place = Place::new();
    place.images(&["a/x1.png", "b/x1.png", "a/x2.png", "b/x2.png"]);
    let expected = [good("x1", [0, 1]), good("x2", [2, 3])];
    assert_eq!(place.frames(&["a", "b"]), expected);
    place.images(&["c/left_1.png", "d/right_1.png"]);
    assert_eq!(place.frames(&["c", "d"]), [good("1", [0, 1])]);
    place.images(&["e/p9.png", "f/q1.png", "e/p10.png", "f/q2.png"]);
    let expected = [good("p9", [0, 1]), good("p10", [2, 3])];
    assert_eq!(place.frames(&["e", "f"]), expected);
}

#[test]
fn patterns_stand_for_numbered_files() {
    let place = Place::new();
    place.images(&["l_00009.png", "r_00009.png", "l_00010.png", "r_00010.png"]);
    let expected = [good("00009", [0, 1]), good("00010", [2, 3])];
    assert_eq!(place.frames(&["l_%05d.png", "r_%05d.png"]), expected);
    let expected = [good("9", [0, 1]), good("10", [2, 3])];
    assert_eq!(place.frames(&["l_%d.png", "r_%d.png"]), expected);
    let message = place.error(&["l_%06d.png", "r_%06d.png"]);
    assert!(message.contains("l_%06d.png"), "{message}");
    // A file of that very name is a file.
    place.images(&["100%d.png", "100%d_b.png"]);
    assert_eq!(
        place.frames(&["100%d.png", "100%d_b.png"]),
        [good("100%d", [0, 1])]
    );
}

#[test]
fn a_picture_of_both_sides_is_divided() {
    let place = Place::new();
    let halves = |is_second: fn(u32, u32) -> bool| {
        RgbImage::from_fn(8, 6, |x, y| Rgb([1 + u8::from(is_second(x, y)), 0, 0]))
    };
    save_png(place.path("a.png"), &halves(|x, _| x >= 4)).unwrap();
    save_png(place.path("b.png"), &halves(|_, y| y >= 3)).unwrap();
    save_png(place.path("odd.png"), &RgbImage::new(7, 5)).unwrap();
    let read =
        |path: &str, layout| numbers(FrameSource::open(&[place.path(path)], Some(layout)).unwrap());
    assert_eq!(read("a.png", Layout::SideBySide), [good("a", [1, 2])]);
    assert_eq!(read("b.png", Layout::TopBottom), [good("b", [1, 2])]);
    for layout in Layout::ALL {
        let reason = read("odd.png", layout)[0].1.clone().unwrap_err();
        assert!(
            reason.contains("odd.png") && reason.contains("halves"),
            "{reason}"
        );
    }
    // As a folder, every picture is one frame.
    assert_eq!(read("", Layout::SideBySide).len(), 3);
}

#[test]
fn a_frame_without_a_partner_says_so_and_the_others_are_read() {
    let place = Place::new();
    place.images(&["left_1.png", "right_1.png", "left_2.png", "right_3.png"]);
    place.images(&["left_4.png", "right_4.png", "left_4.jpg"]);
    let frames = place.frames(&[""]);
    assert_eq!(frames.len(), 4);
    assert_eq!(frames[0], good("1", [0, 1]));
    for (i, words) in [
        (1, ["frame 2", "no right image"]),
        (2, ["frame 3", "no left image"]),
    ] {
        let reason = frames[i].1.clone().unwrap_err();
        assert!(words.iter().all(|word| reason.contains(word)), "{reason}");
    }
    let reason = frames[3].1.clone().unwrap_err();
    assert!(
        reason.contains("left_4.jpg, ") && reason.contains("left_4.png"),
        "{reason}"
    );
}

#[test]
fn what_makes_no_pairs_is_refused_with_the_reason() {
    let place = Place::new();
    place.images(&["a/1.png", "b/x.png", "b/y.png", "one.png"]);
    fs::create_dir(place.path("empty")).unwrap();
    fs::write(place.path("empty/notes.txt"), "x").unwrap();
    for (inputs, words) in [
        (&["a", "b"][..], &["1 and 2 images", "same name"][..]),
        (&["a"], &["no stereo pairs", "left_1.png"]),
        (&["empty"], &["no stereo pairs"]),
        (&["empty", "a"], &["empty", "no PNG, JPEG"]),
        (&["one.png"], &["one.png", "--layout"]),
        (&["nowhere"], &["nowhere", "check the path"]),
        (&["a", "one.png"], &["different kinds"]),
        (&["a", "nowhere"], &["nowhere", "check the path"]),
        (&["a/%d.png", "a"], &["different kinds"]),
        (&["one.png", "two.mp4"], &["a video and an image"]),
        (&[], &["0 inputs"]),
    ] {
        let message = place.error(inputs);
        for word in words {
            assert!(message.contains(word), "{inputs:?}: {message}");
        }
    }
    let both = [place.path("a"), place.path("b")];
    let message = FrameSource::open(&both, Some(Layout::TopBottom)).unwrap_err();
    assert!(message.to_string().contains("top-bottom"), "{message}");
}

/// Frames that count how many of them were made.
fn counted(made: &Arc<AtomicUsize>) -> FrameSource {
    let made = Arc::clone(made);
    let frames = (0..1000).map(move |index| {
        made.fetch_add(1, Ordering::SeqCst);
        StereoFrame {
            index,
            name: index.to_string(),
            origins: [String::new(), String::new()],
            time_s: None,
            images: Ok([RgbImage::new(1, 1), RgbImage::new(1, 1)]),
            read: Duration::ZERO,
        }
    });
    FrameSource {
        frames: Box::new(frames),
        len: Some(1000),
        is_single: false,
        rate_hz: None,
        folders: Vec::new(),
        skipped: Vec::new(),
    }
}

#[test]
fn no_more_frames_are_read_ahead_than_asked_for_and_all_come_in_order() {
    let made = Arc::new(AtomicUsize::new(0));
    let ahead = 4;
    let mut frames = counted(&made).read_ahead(ahead).unwrap();
    for taken in 0..50 {
        assert_eq!(frames.next().unwrap().index, taken);
        // One more is in the reader's hands.
        let most = taken as usize + 1 + ahead + 1;
        assert!(made.load(Ordering::SeqCst) <= most, "after {taken}");
    }
    let rest: Vec<u64> = frames.map(|frame| frame.index).collect();
    assert_eq!(rest, (50..1000).collect::<Vec<_>>());
}

#[test]
fn a_reader_that_nobody_listens_to_stops() {
    let made = Arc::new(AtomicUsize::new(0));
    let mut frames = counted(&made).read_ahead(2).unwrap();
    frames.next();
    // Waits for the thread.
    drop(frames);
    let count = made.load(Ordering::SeqCst);
    assert!(count < 10, "{count}");
}

#[test]
fn a_reader_that_panics_does_not_look_like_the_end() {
    let source = FrameSource {
        frames: Box::new(std::iter::from_fn(|| -> Option<StereoFrame> {
            panic!("defect")
        })),
        len: None,
        is_single: false,
        rate_hz: None,
        folders: Vec::new(),
        skipped: Vec::new(),
    };
    let mut frames = source.read_ahead(1).unwrap();
    let outcome = panic::catch_unwind(panic::AssertUnwindSafe(|| frames.next().is_none()));
    assert!(outcome.is_err());
}

#[test]
fn images_of_all_kinds_are_read_and_what_is_left_out_is_listed() {
    let place = Place::new();
    place.images(&["left/0.png", "right/0.png"]);
    for (number, ending) in [(1, "bmp"), (2, "webp"), (3, "tiff"), (4, "TIF"), (5, "JPG")] {
        for side in ["left", "right"] {
            let image = RgbImage::from_pixel(8, 6, Rgb([number, number, number]));
            image
                .save(place.path(&format!("{side}/{number}.{ending}")))
                .unwrap();
        }
    }
    fs::write(place.path("left/6.heic"), "ftypheic").unwrap();
    fs::write(place.path("right/notes.txt"), "of no concern").unwrap();
    for source in [
        place.open(&[""]).unwrap(),
        place.open(&["left", "right"]).unwrap(),
    ] {
        assert_eq!(source.skipped(), [place.path("left/6.heic")]);
        let names: Vec<String> = numbers(source)
            .into_iter()
            .map(|(name, images)| {
                assert!(images.is_ok(), "{images:?}");
                name
            })
            .collect();
        assert_eq!(names, ["0", "1", "2", "3", "4", "5"]);
    }
    let message = place.open(&[".", "."]).unwrap_err().to_string();
    assert!(
        message.contains("no PNG, JPEG, BMP, WebP or TIFF"),
        "{message}"
    );
}

/// A rotation matrix of `QuickTime`: 16.16 numbers, but for the last column with 2.30.
fn matrix([a, b, c, d]: [i32; 4], [x, y]: [i32; 2]) -> Vec<u8> {
    let numbers = [
        a << 16,
        b << 16,
        0,
        c << 16,
        d << 16,
        0,
        x << 16,
        y << 16,
        1 << 30,
    ];
    numbers.iter().flat_map(|v| v.to_be_bytes()).collect()
}

#[test]
fn turned_videos_come_as_players_show_them() {
    let has_ffmpeg = std::process::Command::new("ffmpeg")
        .arg("-version")
        .output()
        .is_ok();
    if !has_ffmpeg {
        return;
    }
    let place = Place::new();
    // Black above white.
    let frame = RgbImage::from_fn(64, 32, |_, y| Rgb([if y < 16 { 0 } else { 255 }; 3]));
    frame.save(place.path("frame.png")).unwrap();
    let status = std::process::Command::new("ffmpeg")
        .args(["-v", "error", "-y", "-i", "frame.png"])
        .args(["-c:v", "mpeg4", "-q:v", "1", "plain.mp4"])
        .current_dir(place.path(""))
        .status()
        .unwrap();
    assert!(status.success());
    let plain = fs::read(place.path("plain.mp4")).unwrap();
    let header = plain.windows(4).position(|w| w == b"tkhd").unwrap();
    for (name, note, size, dark) in [
        ("none", matrix([1, 0, 0, 1], [0, 0]), (64, 32), (32, 3)),
        ("half", matrix([-1, 0, 0, -1], [64, 32]), (64, 32), (32, 28)),
        // A quarter clockwise: the upper edge goes to the right.
        ("right", matrix([0, 1, -1, 0], [32, 0]), (32, 64), (28, 32)),
        ("left", matrix([0, -1, 1, 0], [0, 64]), (32, 64), (3, 32)),
    ] {
        let mut bytes = plain.clone();
        // Behind version, times, numbers, layer and volume.
        let at = header + 4 + 40;
        bytes[at..at + 36].copy_from_slice(&note);
        let path = place.path(&format!("{name}.mp4"));
        fs::write(&path, bytes).unwrap();
        let frames = FrameSource::open(&[&path, &path], None).unwrap();
        let frame = frames.read_ahead(1).unwrap().next().unwrap();
        let [left, right] = frame.images.unwrap();
        assert_eq!((left.dimensions(), right == left), (size, true), "{name}");
        let (x, y) = dark;
        let opposite = (size.0 - 1 - x, size.1 - 1 - y);
        assert!(left.get_pixel(x, y).0[1] < 40, "{name}");
        assert!(left.get_pixel(opposite.0, opposite.1).0[1] > 215, "{name}");
    }
}
