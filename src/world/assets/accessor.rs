//! Numbers out of a glTF file's buffers, with every bound checked.

use gltf::accessor::{Accessor, DataType, Dimensions};

/// What went wrong, in words for the message about the file.
pub(super) type Problem = String;

/// The elements of an accessor as `N` numbers each; normalised integers become 0 to 1 or -1 to 1.
pub(super) fn numbers<const N: usize>(
    accessor: &Accessor,
    buffers: &[Vec<u8>],
    what: &str,
) -> Result<Vec<[f32; N]>, Problem> {
    let components = components(accessor.dimensions());
    // Colours may have an alpha that nobody asks for.
    if components.is_none_or(|has| has < N) {
        return Err(format!("{what} are no vectors of {N} numbers"));
    }
    let normalized = accessor.normalized();
    let decode = decoder(accessor.data_type(), normalized);
    let size = accessor.data_type().size();
    elements(accessor, buffers, what)?
        .map(|element| {
            let vector: [f32; N] = std::array::from_fn(|i| decode(&element[i * size..]));
            if vector.iter().all(|v| v.is_finite()) {
                Ok(vector)
            } else {
                Err(format!("{what} hold a number that is not finite"))
            }
        })
        .collect()
}

/// The elements of an accessor as indices.
pub(super) fn indices(accessor: &Accessor, buffers: &[Vec<u8>]) -> Result<Vec<u32>, Problem> {
    let data_type = accessor.data_type();
    if components(accessor.dimensions()) != Some(1) {
        return Err("indices are no single numbers".to_owned());
    }
    let decode = |e: &[u8]| match data_type {
        DataType::U8 => Some(u32::from(e[0])),
        DataType::U16 => Some(u32::from(u16::from_le_bytes([e[0], e[1]]))),
        DataType::U32 => Some(u32::from_le_bytes([e[0], e[1], e[2], e[3]])),
        _ => None,
    };
    elements(accessor, buffers, "indices")?
        .map(|element| decode(element).ok_or_else(|| "indices are no whole numbers".to_owned()))
        .collect()
}

const fn components(dimensions: Dimensions) -> Option<usize> {
    match dimensions {
        Dimensions::Scalar => Some(1),
        Dimensions::Vec2 => Some(2),
        Dimensions::Vec3 => Some(3),
        Dimensions::Vec4 => Some(4),
        _ => None,
    }
}

fn decoder(data_type: DataType, normalized: bool) -> impl Fn(&[u8]) -> f32 {
    let scale = move |most: f32| if normalized { 1.0 / most } else { 1.0 };
    move |e| match data_type {
        DataType::F32 => f32::from_le_bytes([e[0], e[1], e[2], e[3]]),
        DataType::U8 => f32::from(e[0]) * scale(255.0),
        DataType::U16 => f32::from(u16::from_le_bytes([e[0], e[1]])) * scale(65_535.0),
        DataType::I8 => (f32::from(e[0].cast_signed()) * scale(127.0)).max(-1.0),
        DataType::I16 => (f32::from(i16::from_le_bytes([e[0], e[1]])) * scale(32_767.0)).max(-1.0),
        DataType::U32 => u32::from_le_bytes([e[0], e[1], e[2], e[3]]) as f32,
    }
}

/// The bytes of each element.
fn elements<'a>(
    accessor: &Accessor,
    buffers: &'a [Vec<u8>],
    what: &str,
) -> Result<impl Iterator<Item = &'a [u8]>, Problem> {
    if accessor.sparse().is_some() {
        return Err(format!("{what} are stored sparsely, which is not read"));
    }
    let Some(view) = accessor.view() else {
        return Err(format!("{what} have no data"));
    };
    let outside = || format!("{what} reach beyond their buffer");
    let element = components(accessor.dimensions())
        .map(|count| count * accessor.data_type().size())
        .ok_or_else(|| format!("{what} are matrices"))?;
    let stride = view.stride().unwrap_or(element);
    let count = accessor.count();
    if stride < element {
        return Err(format!("{what} overlap in their buffer"));
    }
    let bytes = (view.offset().checked_add(view.length()))
        .and_then(|end| buffers.get(view.buffer().index())?.get(view.offset()..end))
        .and_then(|bytes| bytes.get(accessor.offset()..))
        .ok_or_else(outside)?;
    let needed = count.checked_sub(1).map_or(Some(0), |steps| {
        steps.checked_mul(stride)?.checked_add(element)
    });
    if needed.is_none_or(|needed| needed > bytes.len()) {
        return Err(outside());
    }
    Ok((0..count).map(move |index| &bytes[index * stride..index * stride + element]))
}
