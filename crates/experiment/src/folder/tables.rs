//! The tables of a folder, written from its list of runs and the files of the runs.

use jostle_results::contact_statistics::{self, CONTACT_STATISTICS_NAME};
use jostle_results::table;
use jostle_results::table::trajectory::TRAJECTORIES;

use super::Folder;
use super::error::FolderError;
use super::series::{self, SeriesSource};
use crate::plan::Plan;
use crate::series::SeriesKind;

impl Folder {
    /// Returns about the bytes of the tables at most: they have the values of the list of runs and of
    /// the files of long series.
    pub(crate) fn table_bytes(&self) -> u64 {
        let files = self.finished.values().flat_map(|it| &it.record.files);
        let is_series = |name: &str| !name.starts_with(TRAJECTORIES);
        let series = files.filter(|(name, _)| is_series(name));
        self.length + series.map(|(_, length)| length).sum::<u64>()
    }

    /// Writes the tables of the finished runs, in the plan's order.
    ///
    /// # Errors
    ///
    /// [`FolderError`].
    pub fn write_tables(&self, plan: &Plan) -> Result<(), FolderError> {
        let extra = table::occasional(&plan.occasional_columns());
        table::write(&self.path, &self.rows(), &extra)?;
        if plan.touch {
            let entries = self.finished.values();
            let rows = entries.filter_map(|entry| entry.record.touch.clone());
            contact_statistics::write(
                &self.path.join(CONTACT_STATISTICS_NAME),
                &rows.collect::<Vec<_>>(),
            )?;
        }
        for kind in SeriesKind::ALL.into_iter().filter(|kind| kind.is_in(plan)) {
            let mut writer = kind.begin(&self.path.join(kind.table()), plan)?;
            for (&index, entry) in &self.finished {
                if entry.record.row.is_some() && self.is_finished(index) {
                    match series::find(&self.path, plan, index, kind, entry) {
                        SeriesSource::File(path) => writer.append_file(&path)?,
                        source => {
                            let of = (index, kind);
                            writer.append(&series::read(&self.path, plan, of, &source)?)?;
                        }
                    }
                }
            }
            writer.finish()?;
        }
        Ok(())
    }
}
