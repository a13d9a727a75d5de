//! TensorBoard's event files: protocol buffers in `TFRecord` frames.
//!
//! Sources: TensorFlow's `event.proto`, `summary.proto` and `record_writer.h`, of which this writes the parts that
//! carry scalars.

use prost::Message;
use serde_json::Value;

use super::line::{Line, TIME};

/// What a reader expects in the first record.
const FILE_VERSION: &str = "brain.Event:2";

#[derive(Clone, PartialEq, Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Scalar>,
}

#[derive(Clone, PartialEq, Message)]
struct Scalar {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// The first record of a file with these lines.
pub(super) fn header(lines: &[Line]) -> Vec<u8> {
    let (file_version, wall_time) = (Some(FILE_VERSION.into()), lines.first().map(wall_time));
    record(&Event { wall_time: wall_time.unwrap_or_default(), file_version, ..Event::default() })
}

/// A record for each line, with every number of it, at the step that its entry `step_key` counts.
pub(super) fn rows(lines: &[Line], step_key: &str) -> Vec<u8> {
    lines.iter().flat_map(|line| row(line, step_key)).collect()
}

fn row(line: &Line, step_key: &str) -> Vec<u8> {
    let scalar = |(name, value): &(String, Value)| {
        let is_scalar = name != step_key && name != TIME;
        let simple_value = value.as_f64().filter(|_| is_scalar)? as f32;
        Some(Scalar { tag: tag(name), simple_value: Some(simple_value) })
    };
    record(&Event {
        wall_time: wall_time(line),
        step: line.count(step_key).unwrap_or_default() as i64,
        summary: Some(Summary { value: line.0.iter().filter_map(scalar).collect() }),
        ..Event::default()
    })
}

fn wall_time(line: &Line) -> f64 {
    line.get(TIME).and_then(Value::as_f64).unwrap_or_default()
}

/// TensorBoard groups charts by what stands before the slash.
fn tag(name: &str) -> String {
    let group = if name.ends_with("seconds") { "time" } else { "metrics" };
    format!("{group}/{name}")
}

/// Length, its checksum, the message, its checksum; all little-endian.
fn record(event: &Event) -> Vec<u8> {
    let message = event.encode_to_vec();
    let length = (message.len() as u64).to_le_bytes();
    [&length[..], &masked_crc(&length), &message, &masked_crc(&message)].concat()
}

/// CRC-32C, rotated and shifted so that the checksum of data that holds checksums is not degenerate.
fn masked_crc(bytes: &[u8]) -> [u8; 4] {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
}
