//! The capture plan: from where each frame is taken.
//!
//! Within a scene the drone orbits the vehicle: each frame is about 20 degrees further round, and
//! after each full turn it is about 20 degrees higher. Distances are stratified, so that every
//! scene, and with it every split, covers the whole range. Frames are planned without looking at
//! the city ([`plan_scenes`]); [`settle`](super::settle) moves the drone where a building hides the
//! vehicle.

use rand::seq::SliceRandom as _;
use rand::{Rng, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::config::{GenerateConfig, SplitMode, TestProtocol};
use super::part::Part;
use crate::dataset::{Split, View};
use crate::world::Sun;
use crate::world::noise::derive_seed;

/// Half the width of the sectors called front, side and rear, degrees.
const VIEW_SECTOR_DEG: f64 = 25.0;
/// The paper's step round the vehicle and upwards, and the most it varies by, degrees.
const STEP_DEG: f64 = 20.0;
const STEP_JITTER_DEG: f64 = 5.0;
/// The drone keeps below this elevation while there is a choice, degrees.
pub(super) const HIGHEST_DEG: f64 = 75.0;

const PLAN_STREAM: u64 = 4;
const FRAME_STREAM: u64 = 5;

/// The frames of one scene.
#[derive(Debug, Clone)]
pub(super) struct SceneDraft {
    pub number: u32,
    pub frames: Vec<FrameDraft>,
}

/// A frame before anything is known of its scene.
#[derive(Debug, Clone)]
pub(super) struct FrameDraft {
    pub stamp: u64,
    pub split: Split,
    pub scene: u32,
    pub sun: Sun,
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    pub distance_m: f64,
    /// Test frames keep their distance and their side of the vehicle.
    pub side: Option<View>,
    /// Distances within this much of the planned one are as good, metres.
    pub distance_slack_m: f64,
    pub seed: u64,
}

/// The side of a vehicle that a drone at this azimuth sees (0 in front, 180 behind, any sign and
/// number of turns): within 25 degrees of the axis it is front, side or rear, between them other.
pub fn view_of_azimuth(azimuth_deg: f64) -> View {
    let folded = (azimuth_deg % 360.0).abs();
    let from_front = if folded > 180.0 {
        360.0 - folded
    } else {
        folded
    };
    if from_front <= VIEW_SECTOR_DEG {
        View::Front
    } else if from_front >= 180.0 - VIEW_SECTOR_DEG {
        View::Rear
    } else if (from_front - 90.0).abs() <= VIEW_SECTOR_DEG {
        View::Side
    } else {
        View::Other
    }
}

/// All frames of a part, scene by scene: first those of training and validation, then those of the
/// test, which the first part has.
pub(super) fn plan_scenes(config: &GenerateConfig, part: &Part) -> Vec<SceneDraft> {
    let mut rng = Pcg64::seed_from_u64(derive_seed(config.seed, PLAN_STREAM, part.index));
    let (frames, scenes) = (part.frames, config.scenes_of(part.frames));
    let mut drafts: Vec<SceneDraft> = (0..scenes)
        .map(|number| {
            let [first, end] =
                [number, number + 1].map(|n| u64::from(n) * u64::from(frames) / u64::from(scenes));
            let count = (end - first) as u32;
            let number = part.first_scene + number;
            let first = part.first_stamp + first;
            SceneDraft {
                number,
                frames: orbit(config, number, first, count, &mut rng),
            }
        })
        .collect();
    match config.split {
        SplitMode::Scene => split_by_scene(&mut drafts, config.val_fraction, &mut rng),
        SplitMode::Frame => split_by_frame(&mut drafts, config.val_fraction, &mut rng),
    }
    if let Some(test) = &config.test
        && part.index == 0
    {
        drafts.extend(plan_test(config, test, scenes, &mut rng));
    }
    drafts
}

/// The orbit of one scene.
fn orbit(
    config: &GenerateConfig,
    scene: u32,
    first: u64,
    count: u32,
    rng: &mut impl Rng,
) -> Vec<FrameDraft> {
    const FRAMES_PER_TURN: u32 = 18;
    /// Levels of 20 degrees between the lowest and the highest flight.
    const LEVELS: u32 = 4;
    // A scene of less than four turns does not get to every height; scenes then start at different
    // levels, so that together they do.
    let turns = count.div_ceil(FRAMES_PER_TURN);
    let start_level = if turns >= LEVELS {
        0
    } else {
        scene % (LEVELS + 1 - turns.max(1))
    };
    let lowest = rng.random_range(10.0..16.0_f64);
    let mut step = || STEP_DEG + rng.random_range(-STEP_JITTER_DEG..STEP_JITTER_DEG);
    let mut elevation = (0..start_level)
        .fold(lowest, |level, _| level + step())
        .min(HIGHEST_DEG);
    let mut azimuth = rng.random_range(-180.0..180.0_f64);
    let mut round = 0.0;
    let mut strata: Vec<u32> = (0..count).collect();
    strata.shuffle(rng);
    let stratum_m = (config.distance_max_m - config.distance_min_m) / f64::from(count.max(1));
    strata
        .into_iter()
        .enumerate()
        .map(|(index, stratum)| {
            let stamp = first + index as u64;
            let draft = FrameDraft {
                stamp,
                split: Split::Train,
                scene,
                // Offset by the scene, so that suns and strata do not always meet the same way.
                sun: config.suns[(index + scene as usize) % config.suns.len()],
                azimuth_deg: azimuth,
                elevation_deg: elevation,
                distance_m: config.distance_min_m + stratum_m * (f64::from(stratum) + 0.5),
                side: None,
                distance_slack_m: stratum_m * 0.5,
                seed: derive_seed(config.seed, FRAME_STREAM, stamp),
            };
            let step = STEP_DEG + rng.random_range(-STEP_JITTER_DEG..STEP_JITTER_DEG);
            azimuth += step;
            round += step;
            if round >= 360.0 {
                round -= 360.0;
                elevation += STEP_DEG + rng.random_range(-STEP_JITTER_DEG..STEP_JITTER_DEG);
                if elevation > HIGHEST_DEG {
                    elevation = lowest;
                }
            }
            draft
        })
        .collect()
}

/// Gives whole scenes to validation until it has its share; neither side goes away empty-handed
/// where there are two scenes and a share at all.
fn split_by_scene(drafts: &mut [SceneDraft], val_fraction: f64, rng: &mut impl Rng) {
    let total: usize = drafts.iter().map(|d| d.frames.len()).sum();
    let wanted = val_fraction * total as f64;
    let mut order: Vec<usize> = (0..drafts.len()).collect();
    order.shuffle(rng);
    let mut validating = 0.0;
    for &index in order.iter().take(drafts.len().saturating_sub(1)) {
        let frames = drafts[index].frames.len() as f64;
        // Round to the nearest whole scene.
        if wanted <= 0.0 || (validating > 0.0 && validating + frames * 0.5 > wanted) {
            break;
        }
        validating += frames;
        for frame in &mut drafts[index].frames {
            frame.split = Split::Val;
        }
    }
}

fn split_by_frame(drafts: &mut [SceneDraft], val_fraction: f64, rng: &mut impl Rng) {
    let mut frames: Vec<&mut FrameDraft> = drafts.iter_mut().flat_map(|d| &mut d.frames).collect();
    let validating = (val_fraction * frames.len() as f64 + 0.5) as usize;
    frames.shuffle(rng);
    for frame in frames.into_iter().take(validating) {
        frame.split = Split::Val;
    }
}

fn plan_test(
    config: &GenerateConfig,
    test: &TestProtocol,
    first_scene: u32,
    rng: &mut impl Rng,
) -> Vec<SceneDraft> {
    let total = test.frames();
    let mut order: Vec<usize> = (0..total).collect();
    // Which scene a combination comes from is random: no distance, sun or side is one city's alone.
    order.shuffle(rng);
    let mut scenes: Vec<SceneDraft> = (0..test.scenes)
        .map(|i| SceneDraft {
            number: first_scene + i,
            frames: Vec::new(),
        })
        .collect();
    let [suns, views] = [test.suns.len(), test.views.len()];
    for (index, place) in order.into_iter().enumerate() {
        let scene = place * test.scenes as usize / total;
        let side = test.views[index % views];
        let toward = match side {
            View::Rear => 180.0,
            View::Side => [90.0, -90.0][rng.random_range(0..2_usize)],
            View::Front | View::Other => 0.0,
        };
        let stamp = u64::from(config.frames) + index as u64;
        let number = scenes[scene].number;
        scenes[scene].frames.push(FrameDraft {
            stamp,
            split: Split::Test,
            scene: number,
            sun: test.suns[index / views % suns],
            azimuth_deg: toward + rng.random_range(-10.0..10.0_f64),
            elevation_deg: rng.random_range(12.0..38.0_f64),
            distance_m: test.distances_m[index / (views * suns)],
            side: Some(side),
            distance_slack_m: 0.0,
            seed: derive_seed(config.seed, FRAME_STREAM, stamp),
        });
    }
    scenes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(config: &GenerateConfig) -> Vec<SceneDraft> {
        plan_scenes(config, &Part::first(config))
    }

    #[test]
    fn the_sides_of_a_vehicle_are_named_from_any_number_of_turns() {
        for (azimuth, view) in [
            (0.0, View::Front),
            (-25.0, View::Front),
            (335.0, View::Front),
            (26.0, View::Other),
            (65.0, View::Side),
            (-90.0, View::Side),
            (270.0, View::Side),
            (155.0, View::Rear),
            (-180.0, View::Rear),
            (540.0, View::Rear),
            (130.0, View::Other),
        ] {
            assert_eq!(view_of_azimuth(azimuth), view, "{azimuth}");
        }
    }

    #[test]
    fn a_split_by_scene_shares_no_scene_and_gives_validation_its_fifth() {
        let config = GenerateConfig::default();
        let drafts = plan(&config);
        let mut validating = 0;
        for scene in &drafts {
            assert!(
                scene
                    .frames
                    .iter()
                    .all(|f| f.split == scene.frames[0].split)
            );
            validating += if scene.frames[0].split == Split::Val {
                scene.frames.len()
            } else {
                0
            };
        }
        // A fifth of the 360 default frames.
        assert_eq!(validating, 72);
    }

    #[test]
    fn two_frames_are_enough_to_train_on_one_and_validate_on_the_other() {
        for split in [SplitMode::Scene, SplitMode::Frame] {
            let config = GenerateConfig {
                frames: 2,
                val_fraction: 0.5,
                split,
                ..GenerateConfig::default()
            };
            let mut splits: Vec<Split> = plan(&config)
                .iter()
                .flat_map(|s| &s.frames)
                .map(|f| f.split)
                .collect();
            splits.sort();
            assert_eq!(splits, [Split::Train, Split::Val]);
        }
    }

    #[test]
    fn distances_cover_the_range_in_every_scene() {
        let config = GenerateConfig {
            frames: 100,
            frames_per_scene: 10,
            distance_max_m: 60.0,
            ..GenerateConfig::default()
        };
        for scene in plan(&config) {
            let mut bins = [0; 10];
            for frame in &scene.frames {
                bins[((frame.distance_m - 10.0) / 5.0) as usize] += 1;
            }
            assert_eq!(bins, [1; 10]);
        }
    }

    #[test]
    fn the_drone_steps_on_by_20_degrees_and_rises_after_each_turn() {
        let config = GenerateConfig {
            frames: 72,
            frames_per_scene: 72,
            ..GenerateConfig::default()
        };
        let frames: Vec<FrameDraft> = plan(&config)
            .into_iter()
            .flat_map(|s| s.frames)
            .take(36)
            .collect();
        for pair in frames.windows(2) {
            let step = pair[1].azimuth_deg - pair[0].azimuth_deg;
            assert!((15.0..=25.0).contains(&step), "{step}");
            let rise = pair[1].elevation_deg - pair[0].elevation_deg;
            assert!(rise == 0.0 || (15.0..=25.0).contains(&rise), "{rise}");
        }
        assert!(frames[0].elevation_deg < 16.0 && frames[35].elevation_deg > 24.0);
    }

    #[test]
    fn the_papers_test_protocol_is_108_frames_in_scenes_of_their_own() {
        let config = GenerateConfig::preset("paper").unwrap();
        let drafts = plan(&config);
        let test: Vec<&FrameDraft> = drafts
            .iter()
            .flat_map(|s| &s.frames)
            .filter(|f| f.split == Split::Test)
            .collect();
        assert_eq!(test.len(), 108);
        assert!(test.iter().all(|f| f.scene >= config.scenes()));
        for frame in test {
            assert_eq!(Some(view_of_azimuth(frame.azimuth_deg)), frame.side);
        }
    }
}
