//! Operating a farm: copies of it, farms from copies, the doctor; and the papers and files that operators get.

mod backup;
mod shipped_files;
mod traces;
