//! What file names say: which camera took an image, which frame it is, what comes first.

use std::cmp::Ordering;
use std::path::Path;

use crate::dataset::Side;

/// How names of left and right images begin or end, beside a `_`, `-` or `.`.
const WORDS: [[&str; 2]; 2] = [["left", "right"], ["l", "r"]];

/// What divides the side from the rest of a name.
const DIVIDERS: [char; 3] = ['_', '-', '.'];

/// A file's name without folders and ending.
pub(super) fn stem(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

/// Which camera a name without ending speaks of, and the name without that: `left_00042`,
/// `00042_left`, `00042_L` are the left one's 00042.
pub(super) fn side_and_rest(stem: &str) -> Option<(Side, String)> {
    // Not in lower case as a whole: that can change the lengths of other letters.
    let starts = |word: &str| {
        let (head, rest) = stem.split_at_checked(word.len())?;
        head.eq_ignore_ascii_case(word)
            .then(|| rest.strip_prefix(DIVIDERS))?
    };
    let ends = |word: &str| {
        let (rest, tail) = stem.split_at_checked(stem.len().checked_sub(word.len())?)?;
        tail.eq_ignore_ascii_case(word)
            .then(|| rest.strip_suffix(DIVIDERS))?
    };
    WORDS.iter().find_map(|words| {
        Side::ALL.into_iter().zip(words).find_map(|(side, word)| {
            let rest = starts(word).or_else(|| ends(word))?;
            (!rest.is_empty()).then(|| (side, rest.to_owned()))
        })
    })
}

/// What a pair of files is called: what their names have in common but for the side.
pub(super) fn pair_name(paths: [&Path; 2]) -> String {
    let [left, right] = paths.map(stem);
    match (side_and_rest(&left), side_and_rest(&right)) {
        (Some((Side::Left, a)), Some((Side::Right, b))) if a == b => a,
        _ => left,
    }
}

/// The order that people expect: numbers in names by their value, `a2` before `a10`.
pub(super) fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut rest_a, mut rest_b) = (a, b);
    while let (Some(first_a), Some(first_b)) = (rest_a.chars().next(), rest_b.chars().next()) {
        let order = if first_a.is_ascii_digit() && first_b.is_ascii_digit() {
            let (number_a, number_b) = (take_number(&mut rest_a), take_number(&mut rest_b));
            number_a
                .len()
                .cmp(&number_b.len())
                .then_with(|| number_a.cmp(number_b))
        } else {
            rest_a = &rest_a[first_a.len_utf8()..];
            rest_b = &rest_b[first_b.len_utf8()..];
            first_a.cmp(&first_b)
        };
        if order != Ordering::Equal {
            return order;
        }
    }
    rest_a.len().cmp(&rest_b.len()).then_with(|| a.cmp(b))
}

/// The digits that a text begins with, without leading zeros; the text goes on behind them.
fn take_number<'a>(text: &mut &'a str) -> &'a str {
    let end = text
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(text.len());
    let (number, rest) = text.split_at(end);
    *text = rest;
    number.trim_start_matches('0')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_which_camera_took_an_image() {
        for (stem, expected) in [
            ("left_00042", Some((Side::Left, "00042"))),
            ("right_00042", Some((Side::Right, "00042"))),
            ("Right-00042", Some((Side::Right, "00042"))),
            ("street_7_left", Some((Side::Left, "street_7"))),
            ("street_7.R", Some((Side::Right, "street_7"))),
            ("7_L", Some((Side::Left, "7"))),
            ("leftover", None),
            ("left", None),
            ("left_", None),
            ("_l", None),
            ("xl", None),
            ("größe_ı", None),
            ("", None),
        ] {
            let expected = expected.map(|(side, rest)| (side, rest.to_owned()));
            assert_eq!(side_and_rest(stem), expected, "{stem}");
        }
    }

    #[test]
    fn numbers_in_names_are_ordered_by_their_value() {
        let ordered = ["", "a", "a2", "a02", "a10", "a10b", "a010c", "b1", "ä"];
        let mut shuffled = ordered;
        shuffled.reverse();
        shuffled.sort_by(|a, b| natural_order(a, b));
        // Equal numbers: the shorter way of writing comes by the bytes.
        assert_eq!(
            shuffled,
            ["", "a", "a02", "a2", "a10", "a10b", "a010c", "b1", "ä"]
        );
        let long = format!("a{}", "9".repeat(400));
        assert_eq!(natural_order(&long, "a10"), Ordering::Greater);
    }
}
