//! What the surfaces of models are made of.

use glam::Vec3A;
use gltf::material::AlphaMode;
use gltf::texture::WrappingMode;
use sha2::Sha256;

use super::source::Source;
use super::texture::{Texture, Wrap};
use crate::error::Result;
use crate::world::noise::{mix, smooth_step};
use crate::world::sky::LUMA;

/// Brightest light of its own that a surface may have, against a white wall in the sun.
const BRIGHTEST: f32 = 20.0;

/// A point's look; the renderer's words for it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Coat {
    /// Diffuse reflectance.
    pub albedo: Vec3A,
    /// Share of light mirrored straight on, and the share of the point that mirrors at all.
    pub mirror: f32,
    pub gloss: f32,
    /// The broad, coloured highlight of rough metal.
    pub flakes: Vec3A,
    /// Light of its own.
    pub glow: Vec3A,
}

/// One picture as a material uses it.
#[derive(Debug, Clone, Copy)]
struct Slot {
    texture: usize,
    /// Which of the two sets of coordinates, and the change that they undergo first.
    set: usize,
    matrix: [[f32; 3]; 2],
}

/// How alpha is read.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Alpha {
    Opaque,
    /// Below this nothing is there.
    Mask(f32),
    Glass,
}

#[derive(Debug)]
pub(super) struct Material {
    base: [f32; 4],
    base_slot: Option<Slot>,
    metallic: f32,
    roughness: f32,
    rough_slot: Option<Slot>,
    emissive: Vec3A,
    emissive_slot: Option<Slot>,
    alpha: Alpha,
    is_lit: bool,
}

/// All materials of a file with their pictures; the last one is for what has none.
#[derive(Debug)]
pub(super) struct Materials {
    all: Vec<Material>,
    textures: Vec<Texture>,
}

/// A place on a triangle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// Coordinates in the two sets.
    pub uv: [[f32; 2]; 2],
    /// Width of the view in units of each set.
    pub width: [f32; 2],
    /// The colour that the corners carry.
    pub color: Vec3A,
}

impl Materials {
    /// Reads the materials of a file and the pictures that they use.
    pub fn read(source: &Source, digest: &mut Sha256) -> Result<Self> {
        let mut pictures = Pictures {
            source,
            digest,
            keys: Vec::new(),
            textures: Vec::new(),
        };
        let mut all = source
            .document
            .materials()
            .map(|material| pictures.material(&material))
            .collect::<Result<Vec<_>>>()?;
        all.push(Material::PLAIN);
        Ok(Self {
            all,
            textures: pictures.textures,
        })
    }

    /// Bytes of the pictures in memory.
    pub fn bytes(&self) -> usize {
        self.textures.iter().map(Texture::bytes).sum()
    }

    /// The index of the material without a number.
    pub fn plain(&self) -> usize {
        self.all.len() - 1
    }

    /// Whether a material has holes.
    pub fn has_holes(&self, material: usize) -> bool {
        matches!(self.all[material].alpha, Alpha::Mask(_))
    }

    /// Whether something is there.
    pub fn is_solid(&self, material: usize, uv: [[f32; 2]; 2]) -> bool {
        let material = &self.all[material];
        let Alpha::Mask(least) = material.alpha else {
            return true;
        };
        let place = Place {
            uv,
            width: [0.0; 2],
            color: Vec3A::ONE,
        };
        let [.., alpha] = self.picture(material.base_slot, &place);
        alpha * material.base[3] >= least
    }

    fn picture(&self, slot: Option<Slot>, place: &Place) -> [f32; 4] {
        let Some(slot) = slot else {
            return [1.0; 4];
        };
        let texture = &self.textures[slot.texture];
        let [u, v] = place.uv[slot.set];
        let at = slot.matrix.map(|[a, b, c]| a * u + b * v + c);
        let [[a, b, _], [c, d, _]] = slot.matrix;
        let scale = (a * d - b * c).abs().sqrt();
        let [columns, rows] = texture.size();
        let width_px = place.width[slot.set] * scale * (columns * rows).sqrt();
        texture.at(at, width_px)
    }

    /// The look of a place.
    pub fn coat(&self, material: usize, place: &Place) -> Coat {
        let material = &self.all[material];
        let [red, green, blue, alpha] = self.picture(material.base_slot, place);
        let [base_red, base_green, base_blue, base_alpha] = material.base;
        let base = Vec3A::new(red * base_red, green * base_green, blue * base_blue) * place.color;
        let base = base.clamp(Vec3A::ZERO, Vec3A::splat(0.95));
        let [_, rough, metal, _] = self.picture(material.rough_slot, place);
        let metal = (material.metallic * metal).clamp(0.0, 1.0);
        let rough = (material.roughness * rough).clamp(0.0, 1.0);
        let [red, green, blue, _] = self.picture(material.emissive_slot, place);
        let glow = material.emissive * Vec3A::new(red, green, blue);
        if !material.is_lit {
            return Coat {
                albedo: base,
                mirror: 0.0,
                gloss: 0.0,
                flakes: Vec3A::ZERO,
                glow,
            };
        }
        let gloss = smooth_step(0.7, 0.2, rough);
        let coat = Coat {
            albedo: base * mix(1.0, 0.15, metal),
            mirror: mix(0.04, 0.85 * base.dot(LUMA), metal),
            gloss,
            flakes: base * (metal * mix(0.8, 0.35, gloss)),
            glow,
        };
        match material.alpha {
            Alpha::Glass => coat.behind_glass((alpha * base_alpha).clamp(0.0, 1.0)),
            _ => coat,
        }
    }
}

impl Coat {
    /// What can be seen through shows a dark inside, as windows of vehicles do.
    fn behind_glass(self, cover: f32) -> Self {
        let inside = Vec3A::new(0.010, 0.012, 0.013);
        Self {
            albedo: inside + (self.albedo - inside) * cover,
            mirror: mix(0.06, self.mirror, cover),
            gloss: mix(1.0, self.gloss, cover),
            flakes: self.flakes * cover,
            ..self
        }
    }
}

impl Material {
    /// What the format prescribes where a file says nothing, but not the metal: nobody means it.
    const PLAIN: Self = Self {
        base: [0.6, 0.6, 0.6, 1.0],
        base_slot: None,
        metallic: 0.0,
        roughness: 1.0,
        rough_slot: None,
        emissive: Vec3A::ZERO,
        emissive_slot: None,
        alpha: Alpha::Opaque,
        is_lit: true,
    };
}

/// Pictures as they are asked for, each once.
struct Pictures<'a> {
    source: &'a Source,
    digest: &'a mut Sha256,
    /// Texture of the file, and whether it is a colour.
    keys: Vec<(usize, bool)>,
    textures: Vec<Texture>,
}

/// A diffuse colour below this is black: what reflects then is metal.
const BLACK: f32 = 0.05;

/// Colour, metal and roughness of a material.
struct Base<'a> {
    color: [f32; 4],
    picture: Option<gltf::texture::Info<'a>>,
    metallic: f32,
    roughness: f32,
    rough_picture: Option<gltf::texture::Info<'a>>,
}

impl<'a> Base<'a> {
    fn of(material: &gltf::Material<'a>) -> Self {
        let Some(old) = material.pbr_specular_glossiness() else {
            let pbr = material.pbr_metallic_roughness();
            return Self {
                color: pbr.base_color_factor(),
                picture: pbr.base_color_texture(),
                metallic: pbr.metallic_factor(),
                roughness: pbr.roughness_factor(),
                rough_picture: pbr.metallic_roughness_texture(),
            };
        };
        let picture = old.diffuse_texture();
        let [red, green, blue, alpha] = old.diffuse_factor();
        // A body has its diffuse colour, whatever shines on it: left out, the extension's specular
        // colour is that of a mirror, which nobody means.
        let is_metal = picture.is_none()
            && old.specular_glossiness_texture().is_none()
            && red.max(green).max(blue) < BLACK;
        let [red, green, blue] = if is_metal {
            old.specular_factor()
        } else {
            [red, green, blue]
        };
        // A picture says where it shines, which is not read: half of it, everywhere.
        let gloss = match old.specular_glossiness_texture() {
            Some(_) => 0.5 * old.glossiness_factor(),
            None => old.glossiness_factor(),
        };
        Self {
            color: [red, green, blue, alpha],
            picture,
            metallic: f32::from(u8::from(is_metal)),
            roughness: 1.0 - gloss,
            rough_picture: None,
        }
    }
}

impl Pictures<'_> {
    fn material(&mut self, material: &gltf::Material) -> Result<Material> {
        let base = Base::of(material);
        let factors = [
            base.metallic,
            base.roughness,
            material.alpha_cutoff().unwrap_or(0.5),
            material.emissive_strength().unwrap_or(1.0),
        ];
        let colors = base.color.into_iter().chain(material.emissive_factor());
        if colors.chain(factors).any(|v| !v.is_finite()) {
            return Err(self
                .source
                .damaged("a material has a factor that is not finite"));
        }
        let strength = material
            .emissive_strength()
            .unwrap_or(1.0)
            .clamp(0.0, BRIGHTEST);
        Ok(Material {
            base: base.color,
            base_slot: self.slot(base.picture, true)?,
            metallic: base.metallic,
            roughness: base.roughness,
            rough_slot: self.slot(base.rough_picture, false)?,
            emissive: Vec3A::from_array(material.emissive_factor()) * strength,
            emissive_slot: self.slot(material.emissive_texture(), true)?,
            alpha: match material.alpha_mode() {
                AlphaMode::Opaque => Alpha::Opaque,
                AlphaMode::Mask => Alpha::Mask(material.alpha_cutoff().unwrap_or(0.5)),
                AlphaMode::Blend => Alpha::Glass,
            },
            is_lit: !material.unlit(),
        })
    }

    fn slot(&mut self, info: Option<gltf::texture::Info>, is_color: bool) -> Result<Option<Slot>> {
        let Some(info) = info else {
            return Ok(None);
        };
        let transform = info.texture_transform();
        let set = transform
            .as_ref()
            .and_then(gltf::texture::TextureTransform::tex_coord);
        let set = set.unwrap_or(info.tex_coord()) as usize;
        if set > 1 {
            return Err(self.source.error(
                format!("a picture uses the texture coordinates {set}"),
                "only the sets 0 and 1 are read: bake the picture to one of them",
            ));
        }
        let matrix = transform.map_or([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], |t| {
            let [sin, cos] = [libm::sinf(t.rotation()), libm::cosf(t.rotation())];
            let ([width, height], [x, y]) = (t.scale(), t.offset());
            [
                [cos * width, sin * height, x],
                [-sin * width, cos * height, y],
            ]
        });
        if matrix.concat().iter().any(|v| !v.is_finite()) {
            return Err(self.source.damaged("a texture's transform is not finite"));
        }
        let key = (info.texture().index(), is_color);
        let texture = match self.keys.iter().position(|&known| known == key) {
            Some(known) => known,
            None => self.add(&info.texture(), key)?,
        };
        Ok(Some(Slot {
            texture,
            set,
            matrix,
        }))
    }

    fn add(&mut self, texture: &gltf::Texture, key: (usize, bool)) -> Result<usize> {
        let image = self.source.picture(texture.source().index(), self.digest)?;
        let wrap = |mode| match mode {
            WrappingMode::Repeat => Wrap::Repeat,
            WrappingMode::MirroredRepeat => Wrap::Mirror,
            WrappingMode::ClampToEdge => Wrap::Clamp,
        };
        let sampler = texture.sampler();
        let wraps = [wrap(sampler.wrap_s()), wrap(sampler.wrap_t())];
        self.keys.push(key);
        self.textures.push(Texture::new(&image, wraps, key.1));
        Ok(self.textures.len() - 1)
    }
}
