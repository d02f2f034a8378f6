//! What was found, in words and as JSON.

use std::fmt::Write as _;

use serde_json::{Value, json};
use twinsight::calibrate::{
    Estimate, KnownOffset, MOST_ROWS_PX, Offset, RectificationFit, Refined,
};
use twinsight::geometry::{DisparityCorrection, DisparityTerms};
use twinsight::{Error, Result};

/// Distances that the meaning of an error is told for, metres.
const TOLD_M: [f64; 3] = [10.0, 40.0, 100.0];

/// Everything that is told.
pub struct Findings {
    /// Pairs that were looked at.
    pub pairs: usize,
    /// Pairs that could not be used, and why.
    pub unusable: Vec<String>,
    /// Known distances that could not be measured, and why.
    pub unread: Vec<String>,
    /// The rectification of the images as they are.
    pub fit: RectificationFit,
    /// The calibration to be written.
    pub refined: Refined,
    /// The error of disparities that goes with it.
    pub terms: DisparityTerms,
    /// Where its constant comes from.
    pub constant: Constant,
}

/// What is known of the constant of the error of disparities.
pub enum Constant {
    /// Nothing.
    Unknown,
    /// What known distances say.
    Known(KnownOffset),
    /// What so many vehicles, taken for rulers, agree on.
    Rulers {
        /// The constant.
        offset: Offset,
        /// Vehicles asked.
        vehicles: usize,
    },
}

/// The comment at the beginning of a calibration file.
pub fn header(findings: &Findings) -> String {
    let Findings { pairs, fit, .. } = findings;
    let constant = match &findings.constant {
        Constant::Unknown => "the constant of its disparities is not known".to_owned(),
        Constant::Known(offset) => {
            let count = offset.residuals_px.len();
            format!("the constant from {count} known distances")
        }
        Constant::Rulers { vehicles, .. } => {
            format!("the constant from {vehicles} vehicles taken for rulers")
        }
    };
    format!(
        "# Written by `twinsight calibrate` from {} features of {pairs} pairs; {constant}.\n",
        fit.matches
    )
}

/// The findings as a table in words.
pub fn text(findings: &Findings) -> String {
    let Findings { pairs, fit, .. } = findings;
    let mut text = format!(
        "{pairs} pairs, {} features in both images ({} more left out as wrong)\n\n",
        fit.matches, fit.outliers
    );
    rows(&mut text, fit);
    disparities(&mut text, findings);
    text
}

/// What vertical disparities say. Writing to a String cannot fail.
fn rows(text: &mut String, fit: &RectificationFit) {
    writeln!(
        text,
        "The right camera, against its calibration, by the rows of features (± standard error)"
    )
    .ok();
    let mut line = |name: &str, estimate: &Estimate, unit: &str, words: [&str; 2]| {
        let Estimate { value, std } = *estimate;
        let decimals = (1.0 - libm::log10(std.max(1e-6)).floor()).clamp(0.0, 4.0) as usize;
        let meaning = if value.abs() < 2.0 * std {
            "not different from 0"
        } else {
            words[usize::from(value < 0.0)]
        };
        writeln!(
            text,
            "  {name:<17} {value:>9.decimals$} ± {std:<7.decimals$} {unit:<14} {meaning}"
        )
        .ok();
    };
    line(
        "rows, middle",
        &fit.row_offset_px,
        "px",
        ["the right image is lower", "the right image is higher"],
    );
    line("pitch", &fit.pitch_deg, "deg", ["looks up", "looks down"]);
    line(
        "roll",
        &fit.roll_deg,
        "deg",
        ["turned counter-clockwise", "turned clockwise"],
    );
    line(
        "yaw, by curvature",
        &fit.yaw_deg,
        "deg",
        ["looks to the left", "looks to the right"],
    );
    line(
        "focal length",
        &fit.focal_percent,
        "%",
        ["longer", "shorter"],
    );
    line(
        "height",
        &fit.rise_percent,
        "% of baseline",
        ["stands higher", "stands lower"],
    );
    line(
        "lens, bent rows",
        &fit.bend_px,
        "px",
        ["rows sag at the sides", "rows rise at the sides"],
    );
    writeln!(
        text,
        "  Rows are off by up to {:.2} px (19 of 20 features), {:.2} px spread; {:.2} px spread remains.",
        fit.rows_off_px, fit.sigma_before_px, fit.sigma_px
    )
    .ok();
}

/// What the error of disparities is and means.
fn disparities(text: &mut String, findings: &Findings) {
    let Findings {
        refined,
        terms,
        constant,
        ..
    } = findings;
    if refined.is_turned {
        writeln!(
            text,
            "  That is more than {MOST_ROWS_PX} px: the written calibration turns the right camera, \
             and images are\n  resampled by it; rows are then off by up to {:.2} px.",
            refined.fit.rows_off_px
        )
        .ok();
    }
    let rig = &refined.rig;
    let Ok(correction) = DisparityCorrection::new(*terms, rig.left) else {
        return;
    };
    let [width, height] = [rig.left.width, rig.left.height].map(f64::from);
    writeln!(
        text,
        "\nDisparities, measured less true{}, px (± {:.2})",
        match constant {
            Constant::Unknown => ", against those at the middle",
            Constant::Known(_) | Constant::Rulers { .. } => "",
        },
        match constant {
            Constant::Unknown => terms.shape_std_px,
            Constant::Known(_) | Constant::Rulers { .. } => correction.std_px(),
        }
    )
    .ok();
    let columns = [0.0, 0.25, 0.5, 0.75, 1.0];
    write!(text, "  column").ok();
    for part in columns {
        write!(text, "{:>8.0}", part * width).ok();
    }
    text.push('\n');
    for part in [0.0, 0.5, 1.0] {
        write!(text, "  row {:>4.0}", part * height).ok();
        for column in columns {
            let delta_px = correction.delta_px([column * width, part * height]);
            // No -0.00.
            let rounded = (100.0 * delta_px).round() / 100.0 + 0.0;
            write!(text, "{rounded:>+8.2}").ok();
        }
        text.push('\n');
    }
    match constant {
        Constant::Unknown => {
            writeln!(
                text,
                "  The constant that belongs to it cannot be seen in rows; rigs are off by ± {:.1} px. \
                 Half a pixel too\n  much is {}.\n  --distances finds it.",
                terms.constant_std_px,
                meaning(findings, 0.5)
            )
            .ok();
        }
        Constant::Known(offset) => known(text, findings, offset),
        Constant::Rulers { offset, vehicles } => {
            writeln!(
                text,
                "  {vehicles} vehicles as rulers: {:+.2} ± {:.2} px at the middle ({:.2} of it by chance); \
                 uncorrected, that is\n  {}.\n  It trusts the mean size of vehicles: known distances \
                 (--distances) are better.",
                offset.mean_px,
                offset.std_px,
                offset.scatter_px,
                meaning(findings, offset.mean_px)
            )
            .ok();
        }
    }
}

fn known(text: &mut String, findings: &Findings, offset: &KnownOffset) {
    let terms = &findings.terms;
    writeln!(
        text,
        "  {} known distances: {:+.2} ± {:.2} px at the middle; uncorrected, that is\n  {}.\n  \
         Corrected, they are off by {:.2} px (root mean square).",
        offset.residuals_px.len(),
        terms.constant_px,
        terms.constant_std_px,
        meaning(findings, terms.constant_px),
        offset.rms_px
    )
    .ok();
    for index in &offset.doubtful {
        let (Some(reading), Some(residual_px)) = (
            findings.refined.readings.get(*index),
            offset.residuals_px.get(*index),
        ) else {
            continue;
        };
        writeln!(
            text,
            "  line {} (frame {}) is off by {residual_px:+.1} px still, ± {:.1}: is its distance right?",
            reading.line, reading.frame, reading.std_px
        )
        .ok();
    }
}

/// What so much of disparity too much makes of distances.
fn meaning(findings: &Findings, delta_px: f64) -> String {
    let rig = &findings.refined.rig;
    let told: Vec<String> = TOLD_M
        .iter()
        .map(|distance_m| {
            let true_px = rig.disparity_px(*distance_m);
            let seen_px = true_px + delta_px;
            if seen_px <= 0.0 {
                return format!("at {distance_m} m no distance at all");
            }
            let percent = 100.0 * (true_px / seen_px - 1.0);
            let word = if percent < 0.0 { "near" } else { "far" };
            format!("at {distance_m} m {:.1} % too {word}", percent.abs())
        })
        .collect();
    told.join(", ")
}

/// The findings as JSON.
pub fn json(findings: &Findings) -> Result<String> {
    let Findings {
        pairs,
        unusable,
        unread,
        fit,
        refined,
        terms,
        constant,
    } = findings;
    let broken = |error: serde_json::Error| {
        Error::value("--json", error.to_string(), "report this as a bug")
    };
    let value = |of: std::result::Result<Value, serde_json::Error>| of.map_err(broken);
    let constant = match constant {
        Constant::Unknown => json!({ "known_from": null }),
        Constant::Rulers { offset, vehicles } => json!({
            "known_from": "vehicles",
            "vehicles": vehicles,
            "offset": value(serde_json::to_value(offset))?,
        }),
        Constant::Known(offset) => json!({
            "known_from": "distances",
            "readings": value(serde_json::to_value(&refined.readings))?,
            "residuals_px": offset.residuals_px,
            "rms_px": offset.rms_px,
            "doubtful_lines": offset
                .doubtful
                .iter()
                .filter_map(|index| refined.readings.get(*index))
                .map(|reading| reading.line)
                .collect::<Vec<_>>(),
        }),
    };
    let all = json!({
        "pairs": pairs,
        "unusable": unusable,
        "unmeasured_distances": unread,
        "rectification": value(serde_json::to_value(fit))?,
        "written": {
            "right_camera_is_turned": refined.is_turned,
            "rows_off_px": refined.fit.rows_off_px,
            "disparity_correction": value(serde_json::to_value(terms))?,
        },
        "constant": constant,
    });
    serde_json::to_string_pretty(&all)
        .map(|text| text + "\n")
        .map_err(broken)
}
