//! The cells of a CSV with a header, and the lines of its rows.

use csv::{ReaderBuilder, StringRecord, Trim};
use jostle_physics::plural::counted;

/// A CSV. All rows have as many cells as the header.
pub struct Cells {
    /// The names of the columns.
    pub header: Vec<String>,
    /// The rows after the header.
    pub rows: Vec<Vec<String>>,
    /// The line of each row, from 1; the first is that of the header.
    pub lines: Vec<usize>,
}

/// What is wrong with a CSV: a line and a number of a column, both from 1, and the reason.
pub type CellError = (usize, usize, String);

impl Cells {
    /// Reads a CSV of at most `limit` rows; with more, the reason is `too_many`.
    ///
    /// # Errors
    ///
    /// [`CellError`]: it is no CSV, or a row has too few or too many cells.
    pub fn read(text: &str, limit: u64, too_many: &str) -> Result<Self, CellError> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let header = text.lines().next().unwrap_or_default();
        if header.contains(';') && !header.contains(',') {
            let reason = "its columns are separated by semicolons: separate them by commas, and write \
                          numbers with decimal points, as 0.5";
            return Err((1, 1, reason.to_owned()));
        }
        // NumPy's `savetxt` writes the header as a comment.
        let text = text.strip_prefix('#').unwrap_or(text);
        let mut reader = ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .trim(Trim::All)
            .from_reader(text.as_bytes());
        let (mut lines, mut rows): (Vec<usize>, Vec<Vec<String>>) = (Vec::new(), Vec::new());
        let mut line = Lines { at: 0, number: 1 };
        let mut record = StringRecord::new();
        loop {
            let start = usize::try_from(reader.position().byte()).unwrap_or(usize::MAX);
            let number = line.of(text, start);
            match reader.read_record(&mut record) {
                Ok(false) => break,
                Ok(true) => {}
                Err(error) => return Err((number, 1, error.to_string())),
            }
            if let Some(header) = rows.first()
                && header.len() != record.len()
            {
                let (cells, columns) = (record.len(), header.len());
                let [given, needed] =
                    [(cells, "cell"), (columns, "column")].map(|(count, one)| counted(count, one));
                let reason = format!("{given}, but the header has {needed}");
                return Err((number, cells.min(columns) + 1, reason));
            }
            if rows.len() as u64 > limit {
                return Err((number, 1, too_many.to_owned()));
            }
            lines.push(number);
            rows.push(record.iter().map(str::to_owned).collect());
        }
        let mut rows = rows.into_iter();
        Ok(Self {
            header: rows.next().unwrap_or_default(),
            rows: rows.collect(),
            lines,
        })
    }
}

/// The number of the line at a byte, for ascending bytes.
struct Lines {
    at: usize,
    number: usize,
}

impl Lines {
    /// Returns the line of the first character after `start` that is no line break.
    fn of(&mut self, text: &str, start: usize) -> usize {
        let rest = text.get(start..).unwrap_or_default();
        let blank = rest.len() - rest.trim_start_matches(['\n', '\r']).len();
        let passed = text.get(self.at..start + blank).unwrap_or_default();
        self.number += passed.bytes().filter(|&byte| byte == b'\n').count();
        self.at = start + blank;
        self.number
    }
}
