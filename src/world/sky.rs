//! Daylight: the sky's radiance over the hemisphere, the sun through its air mass, and the
//! irradiance that both bring to a surface.
//!
//! The clear sky follows Preetham, Shirley and Smits, *A Practical Analytic Model for Daylight*
//! (SIGGRAPH 1999): Perez' distribution for luminance and chromaticity with coefficients linear in
//! turbidity. The sun's colour is what Rayleigh scattering, aerosols and ozone leave of it after
//! the air mass of its elevation (same source, appendix A.1). The overcast sky is the CIE's.
//!
//! Radiances are in kcd/m2, of linear sRGB primaries.

use glam::Vec3A;

use super::mesh::turn;
use super::noise::{mix, smooth_step};
use super::sun::SunPlace;

/// Texels along a side of the sky's map.
const SIDE: usize = 64;
/// Solar illuminance above the atmosphere, klx.
const SOLAR_KLX: f32 = 128.0;
/// Preetham's zenith is known to be too bright for hazy air; this keeps the sky's share of the
/// light at a quarter on a clear noon, as measured (CIE standard illuminance of clear skies).
const CLEAR_SCALE: f32 = 0.62;

/// The state of the air.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Air {
    /// Haziness: 2 is very clear, 4 hazy, 8 murky.
    pub turbidity: f32,
    /// 0 is a clear sky, 1 a closed layer of cloud that lets no direct sun through.
    pub overcast: f32,
    /// Share of a clear sky covered by single clouds.
    pub clouds: f32,
    /// Distance after which haze leaves 1/e of a surface's light, metres.
    pub haze_m: f32,
}

/// Sun and sky.
#[derive(Debug, Clone)]
pub(crate) struct Light {
    /// Towards the sun, unit length.
    pub direction: Vec3A,
    /// What a white surface that faces the sun sends back.
    pub sun: Vec3A,
    /// The air that the light comes through.
    pub air: Air,
    /// Radiance over the upper hemisphere in an octahedral map, row by row.
    map: Vec<Vec3A>,
    /// Irradiance from the sky over pi as nine spherical harmonics, by normal.
    harmonics: [Vec3A; 9],
    /// What level ground in the open sends up.
    pub ground: Vec3A,
}

impl Light {
    /// The light of a sun's place; `turn_deg` turns the compass against the streets.
    pub fn new(place: SunPlace, air: Air, turn_deg: f32) -> Self {
        let [[sin_up, cos_up], [sin_round, cos_round]] = [
            turn(place.elevation_deg / 360.0),
            turn((place.azimuth_deg + turn_deg) / 360.0),
        ];
        let direction = Vec3A::new(cos_up * cos_round, cos_up * sin_round, sin_up);
        let clear = ClearSky::new(direction, air.turbidity);
        // Cloud covers the sun long before it covers the sky.
        let through = (1.0 - air.overcast) * (1.0 - air.overcast);
        let bare_sun =
            transmittance(place.elevation_deg, air.turbidity) * (SOLAR_KLX / std::f32::consts::PI);
        let sun = bare_sun * through;
        // A closed layer spreads about a third of the sun's and the sky's light.
        let level = (bare_sun.dot(LUMA) * sin_up.max(0.05) + 2.0) * 0.30;
        let layer = Vec3A::new(0.955, 1.0, 1.06) * level;
        let cloud = (bare_sun * (0.10 + 0.25 * sin_up)).max(Vec3A::splat(0.3));
        // Preetham's horizon turns purple under a high sun; it is pale blue.
        let day = smooth_step(10.0, 24.0, place.elevation_deg);
        let map: Vec<Vec3A> = (0..SIDE * SIDE)
            .map(|texel| {
                let toward = direction_of(texel % SIDE, texel / SIDE);
                let blue = clear.radiance(toward);
                let pale = Vec3A::new(blue.x.min(0.90 * blue.y), blue.y, blue.z.max(1.16 * blue.y));
                let blue = blue + (pale - blue) * day;
                // Single clouds whiten the sky on average; their shapes are drawn where seen.
                let mean = blue + (cloud - blue) * (0.35 * air.clouds);
                let grey = layer * ((1.0 + 2.0 * toward.z) * (3.0 / 7.0));
                mean + (grey - mean) * air.overcast
            })
            .collect();
        let mut light = Self {
            direction,
            sun,
            air,
            harmonics: project(&map),
            map,
            ground: Vec3A::ZERO,
        };
        let falling = light.sun * direction.z + light.skylight(Vec3A::Z);
        light.ground = falling * Vec3A::new(0.165, 0.16, 0.15);
        light
    }

    /// Radiance of the sky without the sun's disc in a direction of unit length; below the horizon
    /// that of the horizon.
    pub fn sky(&self, direction: Vec3A) -> Vec3A {
        let up = direction.z.max(0.012);
        let scale = 1.0 / (direction.x.abs() + direction.y.abs() + up);
        let (px, py) = (direction.x * scale, direction.y * scale);
        let place = |v: f32| ((v * 0.5 + 0.5) * SIDE as f32 - 0.5).clamp(0.0, (SIDE - 1) as f32);
        let (u, v) = (place(px + py), place(px - py));
        let (column, row) = ((u as usize).min(SIDE - 2), (v as usize).min(SIDE - 2));
        let (fu, fv) = (u - column as f32, v - row as f32);
        let at = |dx: usize, dy: usize| self.map[(row + dy) * SIDE + column + dx];
        let upper = at(0, 0) * (1.0 - fu) + at(1, 0) * fu;
        let lower = at(0, 1) * (1.0 - fu) + at(1, 1) * fu;
        upper * (1.0 - fv) + lower * fv
    }

    /// What a white surface with this normal sends back of the open sky's light.
    pub fn skylight(&self, n: Vec3A) -> Vec3A {
        let h = &self.harmonics;
        let light = h[0]
            + h[1] * n.y
            + h[2] * n.z
            + h[3] * n.x
            + h[4] * (n.x * n.y)
            + h[5] * (n.y * n.z)
            + h[6] * (3.0 * n.z * n.z - 1.0)
            + h[7] * (n.x * n.z)
            + h[8] * (n.x * n.x - n.y * n.y);
        light.max(Vec3A::ZERO)
    }

    /// The colour of single clouds towards a direction; `thickness` 0..1 darkens their middle.
    pub fn cloud(&self, toward: Vec3A, thickness: f32) -> Vec3A {
        let glow = toward.dot(self.direction).max(0.0);
        let forward = glow * glow * glow * glow;
        let lit = self.sun * (0.30 + 0.35 * forward) * mix(1.0, 0.55, thickness);
        lit + self.skylight(Vec3A::Z) * 0.45
    }

    /// Light with the haze of a distance in front of it.
    pub fn through_haze(&self, light: Vec3A, direction: Vec3A, distance_m: f32) -> Vec3A {
        let depth = distance_m / self.air.haze_m;
        // 1 - exp(-x) to 1e-3 without its cost; the far end goes to 1.
        let thin = 1.0 / (1.0 + depth * (1.0 + depth * (0.5 + depth * (1.0 / 6.0 + depth * 0.05))));
        let level = Vec3A::new(direction.x, direction.y, 0.0).normalize_or(Vec3A::X);
        let air = self.sky(Vec3A::new(level.x, level.y, 0.06)) * 0.9;
        light * thin + air * (1.0 - thin)
    }
}

/// Weights of linear sRGB in luminance.
pub(crate) const LUMA: Vec3A = Vec3A::new(0.2126, 0.7152, 0.0722);

/// The direction in the middle of a texel.
fn direction_of(column: usize, row: usize) -> Vec3A {
    let place = |i: usize| (i as f32 + 0.5) / SIDE as f32 * 2.0 - 1.0;
    let (u, v) = (place(column), place(row));
    let (px, py) = ((u + v) * 0.5, (u - v) * 0.5);
    Vec3A::new(px, py, 1.0 - px.abs() - py.abs()).normalize()
}

/// Irradiance over pi of a map of the upper hemisphere (Ramamoorthi and Hanrahan 2001), with the
/// basis' constants multiplied in.
fn project(map: &[Vec3A]) -> [Vec3A; 9] {
    let mut sums = [Vec3A::ZERO; 9];
    let mut whole = 0.0;
    for (texel, &radiance) in map.iter().enumerate() {
        let d = direction_of(texel % SIDE, texel / SIDE);
        // A texel's solid angle in an octahedral map falls with the cube of the distance to the
        // octahedron's face.
        let reach = d.x.abs() + d.y.abs() + d.z;
        let solid = reach * reach * reach;
        whole += solid;
        let basis = [
            1.0,
            d.y,
            d.z,
            d.x,
            d.x * d.y,
            d.y * d.z,
            3.0 * d.z * d.z - 1.0,
            d.x * d.z,
            d.x * d.x - d.y * d.y,
        ];
        for (sum, value) in sums.iter_mut().zip(basis) {
            *sum += radiance * (value * solid);
        }
    }
    // Squares of the basis' constants, times the cosine lobe's pi, 2 pi / 3, pi / 4 over pi.
    let [zero, one, two] = [0.282_095, 0.488_603, 1.092_548].map(|k: f32| k * k);
    let [polar, sector] = [0.315_392, 0.546_274].map(|k: f32| k * k);
    let factors = [
        zero,
        one * (2.0 / 3.0),
        one * (2.0 / 3.0),
        one * (2.0 / 3.0),
        two * 0.25,
        two * 0.25,
        polar * 0.25,
        two * 0.25,
        sector * 0.25,
    ];
    let hemisphere = 2.0 * std::f32::consts::PI / whole;
    let mut scaled = [Vec3A::ZERO; 9];
    for (out, (sum, factor)) in scaled.iter_mut().zip(sums.into_iter().zip(factors)) {
        *out = sum * (factor * hemisphere);
    }
    scaled
}

/// What the atmosphere leaves of the sun in red, green and blue.
fn transmittance(elevation_deg: f32, turbidity: f32) -> Vec3A {
    /// Wavelengths of the primaries, micrometres.
    const WAVELENGTHS: [f32; 3] = [0.610, 0.549, 0.465];
    /// Ozone's absorption there, 1/cm, and its usual thickness, cm.
    const OZONE: [f32; 3] = [0.120, 0.085, 0.010];
    const OZONE_CM: f32 = 0.35;
    let elevation = elevation_deg.max(0.5);
    let zenith_deg = 90.0 - elevation;
    let [sine, _] = turn(elevation / 360.0);
    let mass = 1.0 / (sine + 0.15 * libm::powf(93.885 - zenith_deg, -1.253));
    let aerosol = 0.046_08 * turbidity - 0.045_86;
    let mut left = [0.0; 3];
    for (out, (wavelength, ozone)) in left.iter_mut().zip(WAVELENGTHS.into_iter().zip(OZONE)) {
        let depth = 0.008_735 * libm::powf(wavelength, -4.08)
            + aerosol * libm::powf(wavelength, -1.3)
            + ozone * OZONE_CM;
        *out = libm::expf(-depth * mass);
    }
    // The sun itself is a little warmer than the primaries' white.
    Vec3A::from_array(left) * Vec3A::new(1.06, 0.99, 0.91)
}

/// Preetham's clear sky.
struct ClearSky {
    sun: Vec3A,
    /// Perez' A to E for luminance Y and chromaticities x and y.
    perez: [[f32; 5]; 3],
    /// The zenith's Y, x, y over Perez' function there.
    scale: [f32; 3],
}

impl ClearSky {
    #[rustfmt::skip]
    fn new(sun: Vec3A, turbidity: f32) -> Self {
        let t = turbidity;
        let perez = [
            [0.1787 * t - 1.4630, -0.3554 * t + 0.4275, -0.0227 * t + 5.3251, 0.1206 * t - 2.5771, -0.0670 * t + 0.3703],
            [-0.0193 * t - 0.2592, -0.0665 * t + 0.0008, -0.0004 * t + 0.2125, -0.0641 * t - 0.8989, -0.0033 * t + 0.0452],
            [-0.0167 * t - 0.2608, -0.0950 * t + 0.0092, -0.0079 * t + 0.2102, -0.0441 * t - 1.6537, -0.0109 * t + 0.0529],
        ];
        let angle = libm::acosf(sun.z.clamp(0.0, 1.0));
        let chi = (4.0 / 9.0 - t / 120.0) * (std::f32::consts::PI - 2.0 * angle);
        let luminance = (4.0453 * t - 4.9710) * libm::tanf(chi) - 0.2155 * t + 2.4192;
        let (a, a2, a3) = (angle, angle * angle, angle * angle * angle);
        let x = t * t * (0.001_66 * a3 - 0.003_75 * a2 + 0.002_09 * a)
            + t * (-0.029_03 * a3 + 0.063_77 * a2 - 0.032_02 * a + 0.003_94)
            + (0.116_93 * a3 - 0.211_96 * a2 + 0.060_52 * a + 0.258_86);
        let y = t * t * (0.002_75 * a3 - 0.006_10 * a2 + 0.003_17 * a)
            + t * (-0.042_14 * a3 + 0.089_70 * a2 - 0.041_53 * a + 0.005_16)
            + (0.153_46 * a3 - 0.267_56 * a2 + 0.066_70 * a + 0.266_88);
        let zenith = [luminance.max(0.6) * CLEAR_SCALE, x, y];
        let mut scale = [0.0; 3];
        for (out, (value, coefficients)) in scale.iter_mut().zip(zenith.into_iter().zip(&perez)) {
            *out = value / Self::perez(coefficients, 1.0, angle, sun.z);
        }
        Self { sun, perez, scale }
    }

    fn perez([a, b, c, d, e]: &[f32; 5], cos_zenith: f32, angle: f32, cos_angle: f32) -> f32 {
        (1.0 + a * libm::expf(b / cos_zenith))
            * (1.0 + c * libm::expf(d * angle) + e * cos_angle * cos_angle)
    }

    fn radiance(&self, toward: Vec3A) -> Vec3A {
        let cos_angle = toward.dot(self.sun).clamp(-1.0, 1.0);
        let angle = libm::acosf(cos_angle);
        let [luminance, x, y] = [0, 1, 2].map(|i| {
            self.scale[i] * Self::perez(&self.perez[i], toward.z.max(0.02), angle, cos_angle)
        });
        let (big_x, big_z) = (x / y * luminance, (1.0 - x - y) / y * luminance);
        Vec3A::new(
            3.2406 * big_x - 1.5372 * luminance - 0.4986 * big_z,
            -0.9689 * big_x + 1.8758 * luminance + 0.0415 * big_z,
            0.0557 * big_x - 0.2040 * luminance + 1.0570 * big_z,
        )
        .max(Vec3A::splat(0.01))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::Sun;

    const CLEAR: Air = Air {
        turbidity: 2.8,
        overcast: 0.0,
        clouds: 0.0,
        haze_m: 2000.0,
    };

    #[test]
    fn irradiance_on_level_ground_agrees_with_the_sum_over_the_sky() {
        for sun in Sun::ALL {
            let light = Light::new(sun.place(), CLEAR, 20.0);
            let (mut sum, mut whole) = (Vec3A::ZERO, 0.0);
            for texel in 0..SIDE * SIDE {
                let d = direction_of(texel % SIDE, texel / SIDE);
                let solid = {
                    let reach = d.x.abs() + d.y.abs() + d.z;
                    reach * reach * reach
                };
                sum += light.map[texel] * (d.z * solid);
                whole += solid;
            }
            let exact = sum * (2.0 / whole);
            let apart = (light.skylight(Vec3A::Z) - exact).abs() / exact;
            assert!(apart.max_element() < 0.08, "{sun:?}: {apart}");
        }
    }

    #[test]
    fn a_low_sun_is_redder_and_weaker_than_a_high_one() {
        let [low, high] = [Sun::Sunset, Sun::Noon].map(|sun| Light::new(sun.place(), CLEAR, 0.0));
        assert!(low.sun.x / low.sun.z > 2.0 * high.sun.x / high.sun.z);
        assert!(low.sun.dot(LUMA) < 0.6 * high.sun.dot(LUMA));
        // Opposite the sun a clear sky is blue.
        let away = Vec3A::new(-high.direction.x, -high.direction.y, 0.6).normalize();
        assert!(high.sky(away).z > 1.3 * high.sky(away).x);
    }

    #[test]
    fn a_closed_layer_of_cloud_lets_no_sun_through_and_is_grey() {
        let air = Air {
            overcast: 1.0,
            ..CLEAR
        };
        let light = Light::new(Sun::Noon.place(), air, 0.0);
        assert_eq!(light.sun, Vec3A::ZERO);
        let [zenith, side] = [Vec3A::Z, Vec3A::new(0.96, 0.0, 0.28)].map(|d| light.sky(d));
        assert!(zenith.dot(LUMA) > 1.5 * side.dot(LUMA));
        assert!((zenith.x / zenith.z - 0.9).abs() < 0.05);
    }
}
