//! What files say, in every form that is read, and files that say nothing usable.

mod files;
mod hostile;
mod images;
mod kinds;

use super::*;

/// Two cameras with lenses, as OpenCV's stereo sample writes them, in one file; 0.12 m apart.
pub(super) const OPENCV: &str = "%YAML:1.0
---
calibration_time: \"Tue Jun  1 10:00:00 2021\"
image_width: 640
image_height: 480
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.3e+02, 0., 3.22e+02, 0., 5.31e+02,
       2.38e+02, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -2.8e-01, 8.0e-02, 1.2e-03, -1.0e-04, 0. ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 5.32e+02, 0., 3.18e+02, 0., 5.33e+02, 2.41e+02, 0., 0.,
       1. ]
D2: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -2.7e-01, 7.0e-02, -4.0e-04, 2.0e-04, 0. ]
R: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 0.99995, 0., 0.01, 0., 1., 0., -0.01, 0., 0.99995 ]
T: !!opencv-matrix
   rows: 3
   cols: 1
   dt: d
   data: [ -1.2e-01, 1.0e-03, -5.0e-04 ]
E: !!opencv-matrix
   rows: 1
   cols: 1
   dt: d
   data: [ 0. ]
";

pub(super) fn read(text: &str) -> StereoCalibration {
    from_text(text, &LoadOptions::default()).unwrap()
}

pub(super) fn refusal(text: &str) -> String {
    from_text(text, &LoadOptions::default())
        .unwrap_err()
        .to_string()
}
