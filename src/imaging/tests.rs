use std::fs;

use super::*;
use image::{GrayImage, ImageBuffer, Luma, Rgb, Rgba, RgbaImage};

fn noise(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        let value = x * 37 + y * 101 + x * y;
        Rgb([value as u8, (value / 3) as u8, (value / 7) as u8])
    })
}

fn message(path: &Path) -> String {
    load_rgb(path).unwrap_err().to_string()
}

#[test]
fn a_written_image_comes_back_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    save_png(&path, &noise(31, 17)).unwrap();
    assert_eq!(load_rgb(&path).unwrap(), noise(31, 17));
}

#[test]
fn a_missing_file_is_named_with_a_remedy() {
    let text = message(Path::new("nowhere/left_00001.png"));
    assert!(
        text.contains("left_00001.png") && text.contains("check the path"),
        "{text}"
    );
}

#[test]
fn truncated_files_are_refused_at_any_length() {
    let folder = tempfile::tempdir().unwrap();
    let png = png_bytes("a.png", &noise(64, 48)).unwrap();
    let mut jpeg = Vec::new();
    noise(64, 48)
        .write_to(&mut Cursor::new(&mut jpeg), ImageFormat::Jpeg)
        .unwrap();
    for (name, bytes, format) in [
        ("a.png", png, ImageFormat::Png),
        ("a.jpg", jpeg, ImageFormat::Jpeg),
    ] {
        let path = folder.path().join(name);
        // A PNG is complete without its 12-byte end chunk.
        let shortest_loss = if format == ImageFormat::Png { 14 } else { 1 };
        for length in [0, 1, 8, 40, bytes.len() / 2, bytes.len() - shortest_loss] {
            fs::write(&path, &bytes[..length]).unwrap();
            let text = message(&path);
            assert!(text.contains(name), "{length} bytes of {name}: {text}");
        }
        fs::write(&path, &bytes).unwrap();
        load_rgb(&path).unwrap();
    }
}

#[test]
fn bmp_webp_and_tiff_hold_the_same_pixels_and_cut_off_ones_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (name, format) in [
        ("a.bmp", ImageFormat::Bmp),
        ("a.webp", ImageFormat::WebP),
        ("a.tif", ImageFormat::Tiff),
        // The content decides.
        ("a.png", ImageFormat::WebP),
        ("frame_7", ImageFormat::Tiff),
    ] {
        let mut bytes = Vec::new();
        noise(31, 17)
            .write_to(&mut Cursor::new(&mut bytes), format)
            .unwrap();
        let path = folder.path().join(name);
        fs::write(&path, &bytes).unwrap();
        assert!(is_image(&path), "{name}");
        assert_eq!(load_rgb(&path).unwrap(), noise(31, 17), "{name}");
        assert_eq!(header(&path).unwrap().shown, [31, 17]);
        for length in [0, 1, 8, 40, bytes.len() / 2] {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(message(&path).contains(name), "{length} bytes of {name}");
        }
    }
}

#[test]
fn files_of_a_folder_are_images_by_ending_or_content_and_others_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let png = png_bytes("a.png", &noise(4, 3)).unwrap();
    for (name, bytes) in [
        ("b.JPEG", &b"damaged"[..]),
        ("a", &png),
        ("c.img", &png),
        ("d.heic", b"ftypheic"),
        ("e.gif", b"GIF89a"),
        ("labels.txt", b"0 0.5"),
        (".hidden.png", &png),
    ] {
        fs::write(folder.path().join(name), bytes).unwrap();
    }
    fs::create_dir(folder.path().join("inner.png")).unwrap();
    let found = files_in(folder.path()).unwrap();
    let names = |paths: &[std::path::PathBuf]| -> Vec<String> {
        let name = |path: &std::path::PathBuf| path.file_name().unwrap().to_owned();
        let names = paths.iter().map(name);
        names.map(|name| name.into_string().unwrap()).collect()
    };
    assert_eq!(names(&found.images), ["a", "b.JPEG", "c.img"]);
    assert_eq!(names(&found.skipped), ["d.heic", "e.gif"]);
    assert_eq!(names(&found.folders), ["inner.png"]);
}

/// A JPEG file without its segments of Huffman tables.
fn without_tables(jpeg: &[u8]) -> Vec<u8> {
    let mut kept = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != 0xDA {
        let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != 0xC4 {
            kept.extend(&jpeg[at..end]);
        }
        at = end;
    }
    kept.extend(&jpeg[at..]);
    kept
}

#[test]
fn jpeg_files_without_huffman_tables_have_the_standard_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    // The encoder writes the standard tables, which webcams leave out.
    let whole = jpeg_bytes(&path, &noise(64, 48)).unwrap();
    let bare = without_tables(&whole);
    assert!(bare.len() + 400 < whole.len());
    fs::write(&path, &whole).unwrap();
    let expected = load_rgb(&path).unwrap();
    fs::write(&path, &bare).unwrap();
    assert_eq!(load_rgb(&path).unwrap(), expected);
    assert_eq!(header(&path).unwrap().stored, [64, 48]);
    for length in 0..bare.len() {
        fs::write(&path, &bare[..length]).unwrap();
        assert!(load_rgb(&path).is_err(), "{length}");
    }
}

#[test]
fn damaged_bytes_and_other_formats_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let mut bytes = png_bytes("a.png", &noise(64, 48)).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    fs::write(&path, &bytes).unwrap();
    assert!(message(&path).contains("cannot be decoded"));
    fs::write(&path, "id class x_min").unwrap();
    assert!(message(&path).contains("not a PNG, JPEG, BMP, WebP or TIFF"));
}

#[test]
fn a_small_file_that_claims_an_enormous_image_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for (width, height) in [(2_000_000_u32, 2_000_000_u32), (32_000, 32_000), (0, 5)] {
        let mut bytes = png_bytes("a.png", &noise(2, 2)).unwrap();
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        let crc = crc32(&bytes[12..29]).to_be_bytes();
        bytes[29..33].copy_from_slice(&crc);
        let path = folder.path().join(format!("{width}.png"));
        fs::write(&path, &bytes).unwrap();
        let text = message(&path);
        assert!(
            text.starts_with("image ") && text.contains(".png"),
            "{text}"
        );
        assert!(width == 0 || text.contains("too large"), "{text}");
    }
}

/// The checksum of PNG chunks.
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            if crc & 1 == 1 {
                crc >> 1 ^ 0xEDB8_8320
            } else {
                crc >> 1
            }
        })
    })
}

#[test]
fn greyscale_alpha_and_sixteen_bits_become_eight_bit_rgb() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let grey = GrayImage::from_fn(3, 2, |x, y| Luma([(x * 40 + y) as u8]));
    grey.save(&path).unwrap();
    assert_eq!(load_rgb(&path).unwrap().get_pixel(2, 1).0, [81; 3]);

    // A transparent pixel keeps its colour: alpha is ignored, not blended.
    RgbaImage::from_pixel(3, 2, Rgba([9, 8, 7, 0]))
        .save(&path)
        .unwrap();
    assert_eq!(load_rgb(&path).unwrap().get_pixel(0, 0).0, [9, 8, 7]);

    // 128 and 129 lie on either side of a half of 257.
    let deep: ImageBuffer<Rgb<u16>, _> = ImageBuffer::from_pixel(3, 2, Rgb([128, 129, 65_535_u16]));
    deep.save(&path).unwrap();
    assert_eq!(load_rgb(&path).unwrap().get_pixel(0, 0).0, [0, 1, 255]);

    let deep: ImageBuffer<Luma<u16>, _> = ImageBuffer::from_pixel(3, 2, Luma([25_700_u16]));
    deep.save(&path).unwrap();
    assert_eq!(load_rgb(&path).unwrap().get_pixel(0, 0).0, [100; 3]);
}

/// A JPEG file with an Exif orientation, 1 to 8, of an image whose left half is black.
fn oriented(path: &Path, orientation: u8) {
    let half = RgbImage::from_fn(32, 16, |x, _| Rgb([if x < 16 { 0 } else { 255 }; 3]));
    let jpeg = jpeg_bytes(path, &half).unwrap();
    // One entry, tag 0x0112, one 16-bit number, little-endian.
    let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut bytes = jpeg[..2].to_vec();
    bytes.extend([0xFF, 0xE1, 0, exif.len() as u8 + 2]);
    bytes.extend(exif);
    bytes.extend(&jpeg[2..]);
    fs::write(path, bytes).unwrap();
}

#[test]
fn pictures_of_turned_cameras_are_turned_as_people_see_and_label_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    // Where the black half is: its side, and whether the picture stands upright.
    for (orientation, black, size) in [
        (1, "left", (32, 16)),
        (2, "right", (32, 16)),
        (3, "right", (32, 16)),
        (4, "left", (32, 16)),
        (6, "top", (16, 32)),
        (8, "bottom", (16, 32)),
        (77, "left", (32, 16)),
    ] {
        oriented(&path, orientation);
        let stored = load_rgb(&path).unwrap();
        assert_eq!(stored.dimensions(), (32, 16));
        assert!(stored.get_pixel(2, 8).0[0] < 30);
        let shown = load_upright(&path).unwrap();
        assert_eq!(shown.dimensions(), size, "{orientation}");
        let header = header(&path).unwrap();
        assert_eq!((header.stored, header.shown), ([32, 16], size.into()));
        assert_eq!(header.is_turned, (2..=8).contains(&orientation));
        let (width, height) = size;
        let (x, y) = match black {
            "left" => (2, height / 2),
            "right" => (width - 3, height / 2),
            "top" => (width / 2, 2),
            _ => (width / 2, height - 3),
        };
        assert!(shown.get_pixel(x, y).0[0] < 30, "{orientation}");
        let opposite = shown.get_pixel(width - 1 - x, height - 1 - y).0[0];
        assert!(opposite > 225, "{orientation}");
    }
    oriented(&path, 6);
    let [left, right] = load_pair(&path, &path).unwrap();
    assert_eq!((left.dimensions(), left == right), ((16, 32), true));
}

#[test]
fn a_pair_of_unequal_sizes_is_refused_naming_both_files_and_sizes() {
    let folder = tempfile::tempdir().unwrap();
    let (left, right) = (
        folder.path().join("left_1.png"),
        folder.path().join("right_1.png"),
    );
    save_png(&left, &noise(8, 6)).unwrap();
    save_png(&right, &noise(8, 5)).unwrap();
    let text = load_pair(&left, &right).unwrap_err().to_string();
    for word in ["left_1.png", "8x6", "right_1.png", "8x5"] {
        assert!(text.contains(word), "{text} should contain {word}");
    }
}
