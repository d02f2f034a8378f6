use super::*;

fn label() -> Label {
    Label {
        id: 12,
        class: 1,
        box_pixel: PixelBox::new(-3.5, 0.0, 1020.0625, 77.1234),
        center_pixel: [508.25, 38.0001],
        distance_m: Some(104.9876),
        kind: BoxKind::Tight,
        visible: Some(0.5),
        ignored: false,
    }
}

#[test]
fn a_label_comes_back_from_its_line() {
    for visible in [None, Some(0.0), Some(0.1234), Some(1.0)] {
        for ignored in [false, true] {
            let label = Label {
                visible,
                ignored,
                ..label()
            };
            assert_eq!(Label::parse_line(&label.to_line()), Ok(Some(label)));
        }
    }
}

#[test]
fn a_label_line_has_the_fields_of_the_format_in_their_order() {
    assert_eq!(
        label().to_line(),
        "12 1 -3.5 0 1020.0625 77.1234 508.25 38.0001 104.9876 tight 0.5"
    );
}

#[test]
fn an_ignored_label_ends_with_the_word_and_nothing_stands_after_it() {
    let ignored = Label {
        ignored: true,
        ..label()
    };
    let line = ignored.to_line();
    assert!(line.ends_with(" tight 0.5 ignored"), "{line}");
    let message = Label::parse_line(&format!("{line} ignored")).unwrap_err();
    assert!(message.contains("surplus field 'ignored'"), "{message}");
}

#[test]
fn an_unknown_distance_is_a_dash() {
    let label = Label {
        distance_m: None,
        ..label()
    };
    let line = label.to_line();
    assert!(line.contains(" 508.25 38.0001 - tight "), "{line}");
    assert_eq!(Label::parse_line(&line), Ok(Some(label)));
}

#[test]
fn numbers_are_rounded_to_four_decimals_and_zero_has_no_sign() {
    let label = Label {
        box_pixel: PixelBox::new(-0.000_01, 1.0 / 3.0, 2e9 / 3.0, 77.0),
        ..label()
    };
    assert!(
        label
            .to_line()
            .starts_with("12 1 0 0.3333 666666666.6667 77 ")
    );
}

#[test]
fn comments_and_empty_lines_are_no_labels() {
    for line in ["", "   ", "# id class", " # 3 0", LABEL_HEADER] {
        assert_eq!(Label::parse_line(line), Ok(None));
    }
    let line = format!("{}  # the red one", label().to_line());
    assert_eq!(Label::parse_line(&line), Ok(Some(label())));
}

#[test]
fn rows_come_back_from_frames_csv_with_unknown_values_unknown() {
    let known = FrameRow {
        stamp: 42,
        split: Split::Val,
        scene: Some(7),
        sun: Some("noon, \"hazy\"".to_owned()),
        view: Some(View::Rear),
        azimuth_deg: Some(181.25),
        elevation_deg: Some(-3.0),
        distance_m: Some(99.5),
    };
    let unknown = FrameRow {
        stamp: 1_718_035_200_123,
        split: Split::Test,
        scene: None,
        sun: None,
        view: None,
        azimuth_deg: None,
        elevation_deg: None,
        distance_m: None,
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    write_frames_csv(&path, &[known.clone(), unknown.clone()]).unwrap();
    assert_eq!(
        read_frames_csv(&path).unwrap(),
        (vec![known, unknown], vec![])
    );
    let text = std::fs::read_to_string(&path).unwrap();
    assert!(
        text.ends_with("\n1718035200123,test,,,,,,\n") && text.contains("\n00042,val,7,"),
        "{text}"
    );
}

#[test]
fn frames_csv_may_lack_columns_have_others_and_come_from_a_spreadsheet() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("frames.csv");
    std::fs::write(
        &path,
        "\u{feff}split,weather, stamp\r\ntrain,rain,00042\r\n",
    )
    .unwrap();
    let (rows, problems) = read_frames_csv(&path).unwrap();
    assert!(problems.is_empty(), "{problems:?}");
    assert_eq!(
        (rows[0].stamp, rows[0].split, rows[0].scene),
        (42, Split::Train, None)
    );
}

#[test]
fn the_words_of_the_format_are_those_of_its_serialised_form() {
    for kind in BoxKind::ALL {
        assert_eq!(
            toml::Value::try_from(kind).unwrap().as_str(),
            Some(kind.word())
        );
        assert_eq!(kind.word().parse(), Ok(*kind));
    }
    assert_eq!(
        "learn".parse::<Split>().unwrap_err(),
        "'learn' is none of train, val, test"
    );
}
