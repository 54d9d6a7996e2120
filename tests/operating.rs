//! Tests the operation of a farm: backups, restores, the doctor, traces, and the files shipped for operators.

mod backup;
mod shipped_files;
mod traces;
