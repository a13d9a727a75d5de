//! The files that metrics are written to.

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::slice;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

use super::line::Line;
use super::{csv, events};
use crate::error::{LearnError, Result};
use crate::files::{append, io, read_regular, write_atomically};

const JSON_LINES: &str = "metrics.jsonl";
/// Far above the lines of any training, bytes.
const LONGEST: u64 = 1 << 30;
/// Whatever can be made again from the lines.
const COPIES: [Copy; 2] = [
    Copy { file: "metrics.csv", header: csv::header, lists_metrics: true, rows: |lines, _| csv::rows(lines) },
    // TensorBoard reads files with `tfevents` in their names.
    Copy {
        file: "events.out.tfevents.metrics",
        header: events::header,
        lists_metrics: false,
        rows: events::rows,
    },
];

/// The lines in another format.
struct Copy {
    file: &'static str,
    /// What the file begins with, given all lines.
    header: fn(&[Line]) -> Vec<u8>,
    /// Whether the header lists the metrics, so that all lines must have the same.
    lists_metrics: bool,
    /// The lines; the second argument is the entry that charts are drawn over.
    rows: fn(&[Line], &str) -> Vec<u8>,
}

/// `metrics.jsonl`, which counts, and its copies for spreadsheets and TensorBoard, which follow from it.
#[derive(Debug, Clone)]
pub struct MetricsLog {
    folder: PathBuf,
    step_key: &'static str,
}

#[derive(Serialize)]
struct Stamped<'a, M> {
    #[serde(flatten)]
    metrics: &'a M,
    /// When the line was written, s since 1970.
    unix_seconds: f64,
}

impl MetricsLog {
    /// The log in a folder, which need not have begun; `step_key` is the entry on the x axis of charts.
    #[must_use]
    pub fn new(folder: &Path, step_key: &'static str) -> Self {
        Self { folder: folder.to_owned(), step_key }
    }

    /// Whether a line has been written.
    #[must_use]
    pub fn exists(&self) -> bool {
        self.path(JSON_LINES).exists()
    }

    /// Appends one line.
    pub fn append(&self, metrics: &impl Serialize) -> Result<()> {
        let unix_seconds = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
        let text = serde_json::to_string(&Stamped { metrics, unix_seconds })
            .map_err(|error| LearnError::Invalid(error.to_string()))?;
        let line = Line::parse(&text)
            .ok_or_else(|| LearnError::Invalid(format!("metrics are not a JSON object: {text}")))?;
        let file = append(&self.path(JSON_LINES), format!("{text}\n").as_bytes())?;
        // A checkpoint must not outlive the lines that led to it. The copies can be made again.
        file.sync_data().map_err(io(&self.path(JSON_LINES)))?;
        let line = slice::from_ref(&line);
        COPIES.iter().try_for_each(|copy| {
            let path = self.path(copy.file);
            let is_new = fs::metadata(&path).map_or(true, |file| file.len() == 0);
            let header = (copy.header)(line);
            if !is_new && copy.lists_metrics && !begins_with(&path, &header)? {
                // An earlier version wrote other metrics.
                return self.rewind(self.step_key, u64::MAX);
            }
            let header = if is_new { header } else { Vec::new() };
            append(&path, &[header, (copy.rows)(line, self.step_key)].concat()).map(|_| ())
        })
    }

    /// Drops the lines whose entry `key` is above `last`, and a line cut short by a kill: the run resumes
    /// from there.
    pub fn rewind(&self, key: &str, last: u64) -> Result<()> {
        if !self.exists() {
            return Ok(());
        }
        let path = self.path(JSON_LINES);
        // A line cut short may end inside a character.
        let bytes = read_regular(&path, LONGEST).map_err(io(&path))?;
        let text = String::from_utf8_lossy(&bytes);
        let is_kept = |line: &Line| line.count(key).is_some_and(|number| number <= last);
        let kept = text.lines().filter_map(|text| Some((text, Line::parse(text).filter(is_kept)?)));
        let (texts, lines): (Vec<&str>, Vec<Line>) = kept.unzip();
        let text: String = texts.iter().flat_map(|text| [*text, "\n"]).collect();
        write_atomically(&path, text.as_bytes())?;
        COPIES.iter().try_for_each(|copy| {
            let header = if lines.is_empty() { Vec::new() } else { (copy.header)(&lines) };
            write_atomically(&self.path(copy.file), &[header, (copy.rows)(&lines, self.step_key)].concat())
        })
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }
}

/// Whether a file begins with these bytes.
fn begins_with(path: &Path, bytes: &[u8]) -> Result<bool> {
    let mut begin = Vec::with_capacity(bytes.len());
    let file = fs::File::open(path).map_err(io(path))?;
    file.take(bytes.len() as u64).read_to_end(&mut begin).map_err(io(path))?;
    Ok(begin == bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct Measured {
        step: u64,
        loss: Option<f64>,
    }

    #[test]
    fn a_rewound_log_equals_one_that_never_went_further_in_every_format() {
        let folder = std::env::temp_dir().join(format!("dappo-learn-metrics-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let log = MetricsLog::new(&folder, "step");
        let names = [JSON_LINES, COPIES[0].file, COPIES[1].file];
        let read = || names.map(|name| fs::read(folder.join(name)).unwrap());
        log.append(&Measured { step: 1, loss: Some(0.5) }).unwrap();
        log.append(&Measured { step: 2, loss: None }).unwrap();
        let before = read();
        log.append(&Measured { step: 3, loss: Some(f64::NAN) }).unwrap();
        // A kill may cut the last line short.
        append(&folder.join(JSON_LINES), b"{\"step\": 4, \"lo").unwrap();
        assert_ne!(read(), before);
        log.rewind("step", 2).unwrap();
        assert_eq!(read(), before);
        let csv = String::from_utf8(before[1].clone()).unwrap();
        let rows: Vec<Vec<&str>> = csv.lines().map(|row| row.split(',').collect()).collect();
        assert_eq!((rows.len(), &rows[0][..2], &rows[1][..2]), (3, &["step", "loss"][..], &["1", "0.5"][..]));
        assert_eq!(rows[2][..2], ["2", ""]);

        // A later version has one metric more.
        let later = serde_json::json!({"step": 3, "loss": 0.25, "new": 7});
        log.append(&later).unwrap();
        let csv = String::from_utf8(read()[1].clone()).unwrap();
        let cells: Vec<Vec<&str>> = csv.lines().map(|row| row.split(',').collect()).collect();
        assert_eq!(cells.iter().map(Vec::len).collect::<Vec<_>>(), [4; 4]);
        let column = |name| cells[0].iter().position(|cell| *cell == name).unwrap();
        assert_eq!(cells[3][column("new")], "7");
        assert_eq!((cells[1][column("step")], cells[1][column("loss")]), ("1", "0.5"));

        log.rewind("step", 0).unwrap();
        assert_eq!(read(), names.map(|_| Vec::<u8>::new()));
        log.append(&Measured { step: 1, loss: None }).unwrap();
        let csv = fs::read_to_string(folder.join(COPIES[0].file)).unwrap();
        assert!(csv.starts_with("step,loss,unix_seconds\n1,,"), "{csv}");
        fs::remove_dir_all(folder).unwrap();
    }
}
