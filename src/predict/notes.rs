//! What is worth saying of the frames of a prediction, each thing once.

use super::FrameRecord;
use crate::pipeline::StereoRanger;
use crate::progress::Progress;
use crate::ranging::{PairDoubt, RigNote};

/// Frames that must look exchanged before it is said while others are still to come: a single one
/// may do so by chance.
const SEVERAL: u64 = 3;

/// What has been said and what may have to be.
#[derive(Debug, Default)]
pub(super) struct Notes {
    sizes: Vec<(u32, u32)>,
    rig: Vec<RigNote>,
    /// Frames with vehicles.
    with_vehicles: u64,
    /// Of these, those whose images look exchanged, and the first one.
    exchanged: u64,
    first_exchanged: Option<(String, PairDoubt)>,
    is_identical_told: bool,
    is_exchanged_told: bool,
}

impl Notes {
    /// Looks at the size of a frame's images.
    pub fn size(&mut self, size: (u32, u32), ranger: &StereoRanger, progress: &dyn Progress) {
        if self.sizes.contains(&size) {
            return;
        }
        self.sizes.push(size);
        for note in ranger.rig_notes(size) {
            if !self.rig.contains(&note) {
                progress.note(&format!("note: {note}"));
                self.rig.push(note);
            }
        }
    }

    /// Looks at what was found in a frame, and what is strange about its images.
    pub fn frame(
        &mut self,
        record: &FrameRecord,
        note: Option<PairDoubt>,
        progress: &dyn Progress,
    ) {
        let (frame, outcome) = (&record.frame, &record.outcome);
        let has_none = outcome.vehicles().is_empty() && outcome.without_distance().is_empty();
        self.with_vehicles += u64::from(!has_none || note.is_some());
        match note {
            Some(note @ PairDoubt::Identical) if !self.is_identical_told => {
                self.is_identical_told = true;
                progress.note(&format!("note: frame {frame}: {note}"));
            }
            Some(note @ PairDoubt::Exchanged { .. }) => {
                self.exchanged += 1;
                self.first_exchanged
                    .get_or_insert_with(|| (frame.clone(), note));
            }
            _ => {}
        }
        if self.exchanged >= SEVERAL {
            self.exchanged(progress);
        }
    }

    /// All frames have been looked at.
    pub fn finish(mut self, progress: &dyn Progress) {
        self.exchanged(progress);
    }

    /// Says that images look exchanged where most frames do.
    fn exchanged(&mut self, progress: &dyn Progress) {
        let Some((frame, note)) = &self.first_exchanged else {
            return;
        };
        if !self.is_exchanged_told && 2 * self.exchanged > self.with_vehicles {
            self.is_exchanged_told = true;
            progress.note(&format!("note: frame {frame}: {note}"));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::pipeline::DetectedIn;
    use crate::predict::tests::{measured, record, vehicle};

    #[derive(Default)]
    struct Heard(Mutex<Vec<String>>);

    impl Progress for Heard {
        fn begin(&self, _: &str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn status(&self, _: &str) {}
        fn note(&self, text: &str) {
            self.0.lock().unwrap().push(text.to_owned());
        }
        fn end(&self) {}
    }

    /// What is said of frames that are good (`g`), exchanged (`x`), identical (`i`) or empty (`e`).
    fn said(frames: &str) -> Vec<String> {
        let heard = Heard::default();
        let mut notes = Notes::default();
        for (number, frame) in frames.chars().enumerate() {
            let exchanged = PairDoubt::Exchanged {
                vehicles: 2,
                found: 0,
                exchanged: 2,
            };
            let (vehicles, note) = match frame {
                'g' => (vec![vehicle(DetectedIn::Both)], None),
                'x' => (vec![], Some(exchanged)),
                'i' => (vec![], Some(PairDoubt::Identical)),
                _ => (vec![], None),
            };
            let record = FrameRecord {
                frame: number.to_string(),
                ..record(measured(vehicles, vec![]))
            };
            notes.frame(&record, note, &heard);
        }
        notes.finish(&heard);
        heard.0.into_inner().unwrap()
    }

    #[test]
    fn exchanged_images_are_told_once_where_most_frames_look_so() {
        for (frames, expected) in [
            ("", 0),
            ("eeg", 0),
            ("x", 1),
            ("ex", 1),
            ("gx", 0),
            ("ggxggg", 0),
            ("xxxxxxxx", 1),
            ("gxexxxg", 1),
        ] {
            let said = said(frames);
            assert_eq!(said.len(), expected, "{frames}: {said:?}");
            assert!(said.iter().all(|text| text.contains("exchanged")));
        }
        assert!(said("egxxx")[0].starts_with("note: frame 2: "));
    }

    #[test]
    fn identical_images_are_told_once_at_the_first_frame() {
        let said = said("ggiii");
        assert_eq!(said.len(), 1);
        assert!(said[0].contains("frame 2") && said[0].contains("the same"));
    }
}
