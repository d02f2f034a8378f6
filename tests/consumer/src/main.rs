//! Prints the distances of the vehicles in a stereo pair: `consumer RUN LEFT RIGHT`.

use twinsight::{DeviceName, StereoRanger, imaging::load_pair};

fn main() -> twinsight::Result<()> {
    let [run, left, right] = [1, 2, 3].map(|i| std::env::args().nth(i).unwrap_or_default());
    let ranger = StereoRanger::load(run, &DeviceName::FLEX.open()?)?;
    let [left, right] = load_pair(left, right)?;
    for vehicle in ranger.estimate(&left, &right)? {
        println!("{} at {:.1} m", vehicle.class, vehicle.distance_m);
    }
    Ok(())
}
