//! The NumPy file format, version 1.0, for one array of records.
//!
//! Source: `numpy.lib.format`. The header has a fixed length here, so that the number of records can be kept
//! up to date in place.

/// Magic string and version.
const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
/// Bytes before the first record: a multiple of 64, as NumPy requires, with room for any of our headers.
pub(super) const HEADER_BYTES: usize = 512;

/// One field of a record; every element has 4 bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Field {
    name: &'static str,
    kind: &'static str,
    shape: Vec<usize>,
}

impl Field {
    pub fn f32(name: &'static str, shape: &[usize]) -> Self {
        Self { name, kind: "<f4", shape: shape.to_vec() }
    }

    pub fn u32(name: &'static str, shape: &[usize]) -> Self {
        Self { name, kind: "<u4", shape: shape.to_vec() }
    }

    pub fn name(&self) -> &'static str {
        self.name
    }

    pub fn bytes(&self) -> usize {
        4 * self.shape.iter().product::<usize>()
    }
}

/// The description of the array without the number of its records: equal for files that fit together.
fn description(fields: &[Field]) -> String {
    let field = |Field { name, kind, shape }: &Field| {
        let sizes: Vec<String> = shape.iter().map(ToString::to_string).collect();
        if sizes.is_empty() {
            format!("('{name}', '{kind}')")
        } else {
            format!("('{name}', '{kind}', ({},))", sizes.join(", "))
        }
    };
    let fields: Vec<String> = fields.iter().map(field).collect();
    format!("{{'descr': [{}], 'fortran_order': False, 'shape': (", fields.join(", "))
}

/// The first bytes of a file with `count` records.
pub(super) fn header(fields: &[Field], count: usize) -> Vec<u8> {
    let dictionary = format!("{}{count},), }}", description(fields));
    let length = HEADER_BYTES - MAGIC.len() - 2;
    debug_assert!(dictionary.len() < length, "room for the header");
    let mut bytes = MAGIC.to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(dictionary.into_bytes());
    bytes.resize(HEADER_BYTES - 1, b' ');
    bytes.push(b'\n');
    bytes
}

/// Whether a file ends where a process ended before it had written its first header: all that there is, is a piece of
/// the header of no records, and perhaps the zeros of a file that was given its length first.
pub(super) fn is_unfinished(fields: &[Field], bytes: &[u8]) -> bool {
    let whole = header(fields, 0);
    let same = bytes.iter().zip(&whole).take_while(|(one, other)| one == other).count();
    bytes.len() <= HEADER_BYTES && same < HEADER_BYTES && bytes[same..].iter().all(|byte| *byte == 0)
}

/// Whether the header is one of these fields but for the number of records, which a process was about to replace when
/// it ended.
pub(super) fn is_torn(fields: &[Field], bytes: &[u8]) -> bool {
    let mut begin = MAGIC.to_vec();
    begin.extend(((HEADER_BYTES - MAGIC.len() - 2) as u16).to_le_bytes());
    begin.extend(description(fields).into_bytes());
    let rest = bytes.get(..HEADER_BYTES).and_then(|bytes| bytes.strip_prefix(&begin[..]));
    rest.is_some_and(|rest| rest.iter().all(|byte| b"0123456789,)} \n".contains(byte)))
}

/// The number of records, if the header is one of these fields.
pub(super) fn count(fields: &[Field], bytes: &[u8]) -> Option<usize> {
    let text = bytes.get(MAGIC.len() + 2..HEADER_BYTES).and_then(|text| std::str::from_utf8(text).ok())?;
    let count = text.strip_prefix(&description(fields))?.split(',').next()?.parse().ok()?;
    (header(fields, count) == bytes[..HEADER_BYTES]).then_some(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_header_tells_its_count_and_belongs_to_its_fields_alone() {
        let fields = [Field::f32("a", &[3, 2]), Field::u32("b", &[])];
        let bytes = header(&fields, 7000);
        assert_eq!(bytes.len() % 64, 0);
        assert_eq!(count(&fields, &bytes), Some(7000));
        assert_eq!(count(&[Field::f32("a", &[3, 3]), Field::u32("b", &[])], &bytes), None);
        assert_eq!(count(&fields, &bytes[..100]), None);
        assert_eq!(count(&fields, &[0; HEADER_BYTES]), None);
    }

    #[test]
    fn a_header_cut_short_by_a_kill_is_distinguished_from_a_foreign_file() {
        let fields = [Field::f32("a", &[3, 2]), Field::u32("b", &[])];
        let whole = header(&fields, 0);
        for length in [0, 1, 100, HEADER_BYTES] {
            for written in [0, 1, 100, HEADER_BYTES - 1] {
                let mut bytes = whole[..written.min(length)].to_vec();
                bytes.resize(length, 0);
                assert!(is_unfinished(&fields, &bytes), "{length} bytes, {written} of the header");
            }
        }
        for foreign in [&whole[..], &[1; 20], &[0; HEADER_BYTES + 1], b"\x93NUMPY\x01\x00\x01"] {
            assert!(!is_unfinished(&fields, foreign), "{foreign:?}");
        }
        // 9 records become 10: the new header reaches any byte, and the old one follows.
        let (old, new) = (header(&fields, 9), header(&fields, 10));
        for at in 0..=HEADER_BYTES {
            let bytes = [&new[..at], &old[at..]].concat();
            assert!(is_torn(&fields, &bytes), "{at}");
        }
        assert!(!is_torn(&[Field::f32("a", &[3, 3]), Field::u32("b", &[])], &old));
        assert!(!is_torn(&fields, &[0; HEADER_BYTES]));
        let foreign = [&old[..HEADER_BYTES - 1], b"x"].concat();
        assert!(!is_torn(&fields, &foreign) && !is_torn(&fields, &old[..100]));
    }
}
