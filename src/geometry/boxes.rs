//! Axis-aligned boxes in pixels.

use serde::{Deserialize, Serialize};

/// An axis-aligned box in pixels: edges, not pixel indices, so width is `x_max - x_min`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PixelBox {
    /// Left edge.
    pub x_min: f64,
    /// Upper edge.
    pub y_min: f64,
    /// Right edge.
    pub x_max: f64,
    /// Lower edge.
    pub y_max: f64,
}

impl PixelBox {
    /// The box with these edges.
    pub const fn new(x_min: f64, y_min: f64, x_max: f64, y_max: f64) -> Self {
        Self {
            x_min,
            y_min,
            x_max,
            y_max,
        }
    }

    /// The box of this size around a centre.
    pub fn from_center(center: [f64; 2], width: f64, height: f64) -> Self {
        let [x, y] = center;
        Self::new(
            x - width / 2.0,
            y - height / 2.0,
            x + width / 2.0,
            y + height / 2.0,
        )
    }

    /// Width, negative for an inverted box.
    pub fn width(&self) -> f64 {
        self.x_max - self.x_min
    }

    /// Height, negative for an inverted box.
    pub fn height(&self) -> f64 {
        self.y_max - self.y_min
    }

    /// Centre (x, y).
    pub fn center(&self) -> [f64; 2] {
        [
            f64::midpoint(self.x_min, self.x_max),
            f64::midpoint(self.y_min, self.y_max),
        ]
    }

    /// Area, zero for an inverted box.
    pub fn area(&self) -> f64 {
        self.width().max(0.0) * self.height().max(0.0)
    }

    /// The part of this box that lies inside an image of the given size.
    ///
    /// A box entirely outside comes back with zero area.
    pub fn clipped(&self, width: f64, height: f64) -> Self {
        Self::new(
            self.x_min.clamp(0.0, width),
            self.y_min.clamp(0.0, height),
            self.x_max.clamp(0.0, width),
            self.y_max.clamp(0.0, height),
        )
    }

    /// The box of the same thing in the mirrored image.
    pub fn mirrored(&self, image_width: f64) -> Self {
        Self::new(
            image_width - self.x_max,
            self.y_min,
            image_width - self.x_min,
            self.y_max,
        )
    }

    /// The smallest square around the same centre that holds this box.
    pub fn squared(&self) -> Self {
        let side = self.width().max(self.height());
        Self::from_center(self.center(), side, side)
    }

    /// What two boxes have in common; inverted, and so without area, where they are apart.
    pub fn intersection(&self, other: &Self) -> Self {
        Self::new(
            self.x_min.max(other.x_min),
            self.y_min.max(other.y_min),
            self.x_max.min(other.x_max),
            self.y_max.min(other.y_max),
        )
    }

    /// The smallest box that holds both.
    pub fn around(&self, other: &Self) -> Self {
        Self::new(
            self.x_min.min(other.x_min),
            self.y_min.min(other.y_min),
            self.x_max.max(other.x_max),
            self.y_max.max(other.y_max),
        )
    }

    /// Intersection over union, 0 where the union is empty.
    pub fn iou(&self, other: &Self) -> f64 {
        let intersection = self.intersection(other).area();
        let union = self.area() + other.area() - intersection;
        if union > 0.0 {
            intersection / union
        } else {
            0.0
        }
    }

    /// All four edges are finite and the box has a positive area.
    pub fn is_valid(&self) -> bool {
        [self.x_min, self.y_min, self.x_max, self.y_max]
            .iter()
            .all(|v| v.is_finite())
            && self.width() > 0.0
            && self.height() > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn iou_of_a_box_with_itself_is_one_and_with_a_disjoint_box_zero() {
        let a = PixelBox::new(1.0, 2.0, 5.0, 9.0);
        assert_eq!(a.iou(&a), 1.0);
        assert_eq!(a.iou(&PixelBox::new(5.0, 2.0, 9.0, 9.0)), 0.0);
    }

    #[test]
    fn iou_of_two_half_overlapping_boxes_is_one_third() {
        let a = PixelBox::new(0.0, 0.0, 2.0, 2.0);
        let b = PixelBox::new(1.0, 0.0, 3.0, 2.0);
        assert!((a.iou(&b) - 1.0 / 3.0).abs() < 1e-12);
    }

    #[test]
    fn squaring_keeps_the_centre_and_covers_the_box() {
        let a = PixelBox::new(10.0, 20.0, 16.0, 40.0);
        let square = a.squared();
        assert_eq!(square.center(), a.center());
        assert_eq!(square.width(), 20.0);
        assert_eq!(square.height(), 20.0);
    }

    #[test]
    fn a_box_outside_the_image_clips_to_nothing() {
        assert_eq!(
            PixelBox::new(-9.0, -9.0, -1.0, -1.0)
                .clipped(100.0, 100.0)
                .area(),
            0.0
        );
    }
}
