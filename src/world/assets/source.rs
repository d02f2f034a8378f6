//! The bytes of a glTF file and of the files that belong to it.

use std::fs;
use std::path::{Component, Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use gltf::json::extensions::ENABLED_EXTENSIONS;
use gltf::{Document, Gltf};
use image::RgbaImage;
use sha2::{Digest as _, Sha256};

use crate::error::{Error, Result};

/// Larger files are not read.
const LARGEST_FILE: u64 = 256 << 20;
/// Longer sides of pictures are refused before they are decoded.
const LARGEST_PICTURE: u32 = 16_384;
const EXPORT_AGAIN: &str = "export the model again as one .glb file";

/// A glTF file with its buffers.
pub(super) struct Source {
    path: PathBuf,
    pub document: Document,
    pub buffers: Vec<Vec<u8>>,
}

impl Source {
    /// Reads a file and its buffers; everything that is read goes into `digest`.
    pub fn read(path: &Path, digest: &mut Sha256) -> Result<Self> {
        let bytes = read_file(path)?;
        digest.update(&bytes);
        // The header's length counts the header itself, which the parser takes for granted.
        if let [b'g', b'l', b'T', b'F', _, _, _, _, length @ ..] = bytes.as_slice()
            && length
                .first_chunk()
                .is_none_or(|&l| u32::from_le_bytes(l) < 12)
        {
            return Err(Error::asset(path, "is cut off or damaged", EXPORT_AGAIN));
        }
        let Gltf { document, blob } = Gltf::from_slice_without_validation(&bytes)
            .map_err(|error| unreadable(path, &error))?;
        let json = document.into_json();
        let is_known = |name: &&String| ENABLED_EXTENSIONS.contains(&name.as_str());
        let unknown: Vec<&str> = json
            .extensions_required
            .iter()
            .filter(|name| !is_known(name))
            .map(String::as_str)
            .collect();
        if !unknown.is_empty() {
            return Err(unread_extensions(path, &unknown));
        }
        // gltf-json 1.4 looks these up before it checks that they are there, and panics.
        let mut primitives = json.meshes.iter().flat_map(|mesh| &mesh.primitives);
        let exists = |index: usize| index < json.accessors.len();
        if !primitives.all(|primitive| primitive.attributes.values().all(|i| exists(i.value()))) {
            let problem = "a mesh refers to numbers that do not exist";
            return Err(Error::asset(path, problem, EXPORT_AGAIN));
        }
        let document = Document::from_json(json).map_err(|error| unreadable(path, &error))?;
        let mut source = Self {
            path: path.to_owned(),
            document,
            buffers: Vec::new(),
        };
        source.buffers = source.read_buffers(blob, digest)?;
        Ok(source)
    }

    /// An error about this file.
    pub fn error(&self, problem: impl Into<String>, remedy: impl Into<String>) -> Error {
        Error::asset(&self.path, problem, remedy)
    }

    /// An error about this file that only its author's program can mend.
    pub fn damaged(&self, problem: impl Into<String>) -> Error {
        self.error(problem, EXPORT_AGAIN)
    }

    fn read_buffers(&self, blob: Option<Vec<u8>>, digest: &mut Sha256) -> Result<Vec<Vec<u8>>> {
        let mut blob = blob;
        self.document
            .buffers()
            .map(|buffer| {
                let bytes = match buffer.source() {
                    gltf::buffer::Source::Bin => blob.take().ok_or_else(|| {
                        self.damaged(format!("buffer {} has no data", buffer.index()))
                    })?,
                    gltf::buffer::Source::Uri(uri) => self.read_uri(uri, digest)?,
                };
                if bytes.len() < buffer.length() {
                    let [wanted, has] = [buffer.length(), bytes.len()];
                    return Err(self.damaged(format!(
                        "buffer {} should have {wanted} bytes but has {has}",
                        buffer.index()
                    )));
                }
                Ok(bytes)
            })
            .collect()
    }

    /// A picture by its index in the file.
    pub fn picture(&self, index: usize, digest: &mut Sha256) -> Result<RgbaImage> {
        let json = &self.document.as_json().images[index];
        let bytes = match (&json.uri, json.buffer_view) {
            (Some(uri), _) => self.read_uri(uri, digest)?,
            (None, Some(view)) => {
                let view = self.document.views().nth(view.value());
                let bytes = view.and_then(|view| {
                    let end = view.offset().checked_add(view.length())?;
                    let buffer = self.buffers.get(view.buffer().index())?;
                    buffer.get(view.offset()..end)
                });
                let outside = || format!("picture {index} reaches beyond its buffer");
                bytes.ok_or_else(|| self.damaged(outside()))?.to_vec()
            }
            (None, None) => return Err(self.damaged(format!("picture {index} has no data"))),
        };
        let unusable = |error: &dyn std::fmt::Display| {
            self.error(
                format!("picture {index} cannot be decoded: {error}"),
                "pictures are PNG, JPEG or WebP of at most 16384 pixels a side",
            )
        };
        let mut reader = image::ImageReader::new(std::io::Cursor::new(bytes))
            .with_guessed_format()
            .map_err(|error| unusable(&error))?;
        let mut limits = image::Limits::default();
        limits.max_image_width = Some(LARGEST_PICTURE);
        limits.max_image_height = Some(LARGEST_PICTURE);
        reader.limits(limits);
        let image = reader.decode().map_err(|error| unusable(&error))?;
        Ok(image.into_rgba8())
    }

    /// What a URI names: data in itself, or a file beside this one or in a folder there.
    fn read_uri(&self, uri: &str, digest: &mut Sha256) -> Result<Vec<u8>> {
        if let Some(data) = uri.strip_prefix("data:") {
            let bytes = data
                .split_once(";base64,")
                .and_then(|(_, text)| STANDARD.decode(text.trim_end()).ok());
            return bytes.ok_or_else(|| self.damaged("embedded data is no base64"));
        }
        let name = percent_encoding::percent_decode_str(uri).decode_utf8_lossy();
        let relative = Path::new(name.as_ref());
        let stays = relative
            .components()
            .all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        if !stays || name.contains([':', '\\', '\0']) || name.is_empty() {
            return Err(self.error(
                format!("refers to {uri:?}, which is not in its folder"),
                EXPORT_AGAIN,
            ));
        }
        let path = self.path.with_file_name("").join(relative);
        if !path.exists() {
            return Err(self.error(
                format!("needs {}, which is missing", path.display()),
                format!("put that file there, or {EXPORT_AGAIN}"),
            ));
        }
        let bytes = read_file(&path)?;
        digest.update(&bytes);
        Ok(bytes)
    }
}

/// The error of extensions that a file cannot do without.
fn unread_extensions(path: &Path, names: &[&str]) -> Error {
    let all = names.join(", ");
    let remedy = if ["draco", "meshopt", "quantization"]
        .iter()
        .any(|word| all.contains(word))
    {
        "export it again without compression (Draco, meshopt, quantisation)"
    } else if all.contains("texture") {
        "export it again with PNG or JPEG pictures"
    } else {
        "export it again without that, as plain glTF 2.0"
    };
    Error::asset(
        path,
        format!("needs the glTF extensions {all}, which are not read"),
        remedy,
    )
}

fn unreadable(path: &Path, error: &gltf::Error) -> Error {
    let problem = match error {
        gltf::Error::Validation(all) => {
            let first = all.iter().map(|(place, error)| format!("{place}: {error}"));
            first.take(1).collect()
        }
        other => other.to_string(),
    };
    Error::asset(
        path,
        format!("is no readable glTF 2.0: {problem}"),
        EXPORT_AGAIN,
    )
}

fn read_file(path: &Path) -> Result<Vec<u8>> {
    let metadata = fs::metadata(path).map_err(Error::io("read", path))?;
    if !metadata.is_file() {
        return Err(Error::asset(path, "is no file", "put a file there"));
    }
    if metadata.len() > LARGEST_FILE {
        return Err(Error::asset(
            path,
            format!("has {} MB", metadata.len() >> 20),
            format!(
                "files may have {} MB: simplify the model",
                LARGEST_FILE >> 20
            ),
        ));
    }
    fs::read(path).map_err(Error::io("read", path))
}
