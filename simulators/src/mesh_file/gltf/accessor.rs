//! Numbers out of buffers: component types, strides, and the ends of buffers that are checked before anything is read.

use super::{MeshFileError, Reader, broken};

impl Reader<'_> {
    /// The vectors of `N` numbers of an accessor; fails when it is not there, of another kind, or leaves its buffer.
    pub(super) fn numbers<const N: usize>(&self, index: usize) -> Result<Vec<[f64; N]>, MeshFileError> {
        let refuse = |why: String| broken(self.path, format!("accessor {index}: {why}"));
        let accessor = self.document.accessors.get(index).ok_or_else(|| self.missing("accessor", index))?;
        let kind = ["SCALAR", "VEC2", "VEC3"][N - 1];
        if accessor.kind != kind {
            return Err(refuse(format!("expected {kind}, got {}", accessor.kind)));
        }
        let component = Component::of(accessor.component_type)
            .ok_or_else(|| refuse(format!("component type {} is not known", accessor.component_type)))?;
        let view = accessor.buffer_view.ok_or_else(|| refuse("sparse data are not read".to_owned()))?;
        let (bytes, stride) = self.view(view)?;
        let item = N * component.bytes();
        let stride = stride.unwrap_or(item);
        let vector = |number: usize| -> Option<[f64; N]> {
            let start = number.checked_mul(stride)?.checked_add(accessor.byte_offset)?;
            let item = bytes.get(start..start.checked_add(item)?)?;
            let mut vector = [0.0; N];
            for (value, bytes) in vector.iter_mut().zip(item.chunks_exact(component.bytes())) {
                *value = component.read(bytes) * if accessor.normalized { component.unit() } else { 1.0 };
            }
            Some(vector)
        };
        // The last first: nothing is made room for that is not there.
        if accessor.count > 0 && (stride == 0 || vector(accessor.count - 1).is_none()) {
            return Err(refuse(format!("{} items leave their {} bytes", accessor.count, bytes.len())));
        }
        Ok((0..accessor.count).map_while(vector).collect())
    }

    /// The bytes of a buffer view, and the distance of its items if it says so.
    pub(super) fn view(&self, index: usize) -> Result<(&[u8], Option<usize>), MeshFileError> {
        let view = self.document.buffer_views.get(index).ok_or_else(|| self.missing("buffer view", index))?;
        let buffer = self.buffers.get(view.buffer).ok_or_else(|| self.missing("buffer", view.buffer))?;
        let bytes = buffer.get(view.byte_offset..).and_then(|rest| rest.get(..view.byte_length));
        let bytes = bytes.ok_or_else(|| {
            let (offset, length) = (view.byte_offset, view.byte_length);
            let why = format!("buffer view {index}: {length} bytes from {offset} leave a buffer of {}", buffer.len());
            broken(self.path, why)
        })?;
        Ok((bytes, view.byte_stride))
    }
}

/// How a number is stored.
#[derive(Clone, Copy)]
enum Component {
    U8,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: u32) -> Option<Component> {
        match code {
            5121 => Some(Component::U8),
            5123 => Some(Component::U16),
            5125 => Some(Component::U32),
            5126 => Some(Component::F32),
            _ => None,
        }
    }

    fn bytes(self) -> usize {
        match self {
            Component::U8 => 1,
            Component::U16 => 2,
            Component::U32 | Component::F32 => 4,
        }
    }

    /// `bytes` has as many as [`Component::bytes`].
    fn read(self, bytes: &[u8]) -> f64 {
        match (self, bytes) {
            (Component::U8, &[a]) => f64::from(a),
            (Component::U16, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (Component::U32, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (Component::F32, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => f64::NAN,
        }
    }

    /// What the largest number is divided by to be 1.
    fn unit(self) -> f64 {
        match self {
            Component::U8 => 1.0 / 255.0,
            Component::U16 => 1.0 / 65535.0,
            Component::U32 | Component::F32 => 1.0,
        }
    }
}
