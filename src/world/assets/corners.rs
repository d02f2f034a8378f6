//! The corners of a glTF primitive with what each of them carries.

use glam::Vec3A;
use gltf::{Primitive, Semantic};

use super::accessor::{indices, numbers};
use super::source::Source;
use crate::error::Result;

/// The corners, in the file's order.
pub(super) struct Corners {
    pub positions: Vec<[f32; 3]>,
    pub normals: Option<Vec<[f32; 3]>>,
    colors: Option<Vec<[f32; 3]>>,
    /// The two sets of texture coordinates.
    sets: [Option<Vec<[f32; 2]>>; 2],
    /// Which corners follow one another.
    pub order: Vec<u32>,
}

impl Corners {
    /// Reads them; None where there are none.
    pub fn read(primitive: &Primitive, source: &Source) -> Result<Option<Self>> {
        let buffers = &source.buffers;
        let damaged = |problem| source.damaged(problem);
        let Some(accessor) = primitive.get(&Semantic::Positions) else {
            return Ok(None);
        };
        let positions: Vec<[f32; 3]> = numbers(&accessor, buffers, "positions").map_err(damaged)?;
        let vectors = |semantic, what| {
            let accessor = primitive.get(&semantic);
            let read = accessor.map(|a| numbers(&a, buffers, what).map_err(damaged));
            read.transpose()
        };
        let mut sets = [None, None];
        for (number, set) in (0..).zip(&mut sets) {
            let accessor = primitive.get(&Semantic::TexCoords(number));
            let read = accessor.map(|a| numbers(&a, buffers, "texture coordinates"));
            *set = read.transpose().map_err(damaged)?;
        }
        let order = match primitive.indices() {
            Some(accessor) => indices(&accessor, buffers).map_err(damaged)?,
            None => (0..positions.len() as u32).collect(),
        };
        let corners = Self {
            normals: vectors(Semantic::Normals, "normals")?,
            colors: vectors(Semantic::Colors(0), "colours")?,
            positions,
            sets,
            order,
        };
        corners
            .validate()
            .map_err(|problem| source.damaged(problem))?;
        Ok(Some(corners))
    }

    fn validate(&self) -> Result<(), &'static str> {
        let count = self.positions.len();
        let vectors = [&self.normals, &self.colors].map(|v| v.as_ref().map(Vec::len));
        let sets = self.sets.iter().map(|set| set.as_ref().map(Vec::len));
        if vectors.into_iter().chain(sets).flatten().any(|n| n < count) {
            return Err("has fewer normals, colours or texture coordinates than corners");
        }
        if self.order.iter().any(|&index| index as usize >= count) {
            return Err("an index names a corner that does not exist");
        }
        Ok(())
    }

    /// Both pairs of texture coordinates of a corner.
    pub fn uv(&self, corner: usize) -> [[f32; 2]; 2] {
        std::array::from_fn(|set| self.sets[set].as_ref().map_or([0.0; 2], |uv| uv[corner]))
    }

    /// The colour of a corner.
    pub fn color(&self, corner: usize) -> Vec3A {
        let colors = self.colors.as_ref();
        colors.map_or(Vec3A::ONE, |all| Vec3A::from_array(all[corner]))
    }
}
