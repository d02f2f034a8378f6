use super::*;
use crate::dataset::fixture::Fixture;
use crate::progress::Silent;

/// The names of the elements of a page that are opened and not closed; void elements are neither.
fn unclosed(html: &str) -> Vec<String> {
    const VOID: [&str; 4] = ["meta", "img", "br", "!DOCTYPE"];
    let mut open: Vec<String> = Vec::new();
    for part in html.split('<').skip(1) {
        let tag = part.split('>').next().unwrap();
        let name = tag.trim_start_matches('/');
        let name = name
            .split(|c: char| c.is_whitespace() || c == '/')
            .next()
            .unwrap();
        if tag.starts_with('/') {
            assert_eq!(
                open.pop().as_deref(),
                Some(name),
                "</{name}> closes something else"
            );
        } else if !VOID.contains(&name) && !tag.ends_with('/') {
            open.push(name.to_owned());
        }
    }
    open
}

#[test]
fn the_page_is_whole_and_needs_nothing_from_elsewhere() {
    let fixture = Fixture::lawful(9);
    let out = tempfile::tempdir().unwrap();
    let done = inspect(&fixture.open(), BoxKind::Tight, out.path(), &Silent).unwrap();
    let html = std::fs::read_to_string(&done.page).unwrap();
    assert_eq!(unclosed(&html), Vec::<String>::new());
    for foreign in ["src=\"http", "href=", "<script", "@import", "url("] {
        assert!(!html.contains(foreign), "{foreign}");
    }
    assert_eq!(html.matches("data:image/jpeg;base64,").count(), 9);
    assert!(html.matches("<svg").count() >= 3);
    for text in ["Distance of vehicles", "train", "val", "test", "noon"] {
        assert!(html.contains(text), "{text}");
    }
    let sheet = image::open(&done.sheet).unwrap();
    assert!(sheet.width() > 1000 && sheet.height() > 200);
}

#[test]
fn the_same_dataset_gives_the_same_files() {
    let fixture = Fixture::lawful(5);
    let read = || {
        let out = tempfile::tempdir().unwrap();
        let done = inspect(&fixture.open(), BoxKind::Sphere, out.path(), &Silent).unwrap();
        (
            std::fs::read(done.page).unwrap(),
            std::fs::read(done.sheet).unwrap(),
        )
    };
    assert!(read() == read());
}

#[test]
fn counts_are_those_of_the_labels() {
    let fixture = Fixture::lawful(10);
    let summary = Summary::new(&fixture.open(), BoxKind::Sphere);
    let of = |f: fn(&SplitSummary) -> usize| summary.splits.iter().map(f).collect::<Vec<_>>();
    assert_eq!(of(|s| s.frames), [6, 2, 2]);
    assert_eq!(of(|s| s.images), [12, 4, 4]);
    // The second vehicle is ignored in the frames 3, 6 and 9.
    assert_eq!(of(|s| s.vehicles), [10, 3, 4]);
    assert_eq!(of(|s| s.ignored), [2, 1, 0]);
    assert_eq!(of(|s| s.pairs), [10, 3, 4]);
}

#[test]
fn names_are_escaped_and_a_dataset_without_vehicles_can_be_shown() {
    let fixture = Fixture::lawful(2);
    for stamp in 1..=2 {
        for side in ["left", "right"] {
            fixture.write(&format!("frames/{side}_{stamp:05}.txt"), "");
        }
    }
    fixture.edit("dataset.toml", "[\"car\"]", "[\"<b>car\"]");
    let out = tempfile::tempdir().unwrap();
    let done = inspect(&fixture.open(), BoxKind::Sphere, out.path(), &Silent).unwrap();
    let html = std::fs::read_to_string(done.page).unwrap();
    assert!(html.contains("&lt;b&gt;car") && !html.contains("<b>car"));
    assert_eq!(unclosed(&html), Vec::<String>::new());
}
