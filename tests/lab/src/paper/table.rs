//! The measured table as text.

use super::published::HARDWARE;
use super::{GpuRow, Row, Table};

/// The table, and the published one.
pub(super) fn text(table: &Table) -> String {
    let gpu = table.gpu.as_deref().unwrap_or("no GPU");
    let mut lines = vec![
        format!("{}, {} samples, on {gpu} and {} threads of {}", table.scene, table.samples, table.threads, table.simd),
        "\nthis machine: ms of kernels, one scalar thread, all threads; ×: speed relative to the one thread".to_owned(),
        format!(
            "{:<11} {:>8} {:>10} {:>9} {:>9} {:>7} {:>9} {:>17} {:>9} {:>6}",
            "",
            "GPU ms",
            "serial ms",
            "SIMD ms",
            "GPU ×",
            "SIMD ×",
            "registers",
            "occ. ach./theor.",
            "uniform",
            "lanes"
        ),
    ];
    lines.extend(table.rows.iter().map(measured));
    lines.push(format!("\n{HARDWARE}"));
    lines.push(format!(
        "{:<11} {:>8} {:>10} {:>9} {:>17} {:>9} {:>9} {:>12}",
        "", "GPU ms", "serial s", "GPU ×", "occ. ach./theor.", "uniform", "H200 ms", "over it here"
    ));
    lines.extend(table.rows.iter().filter_map(published));
    lines.join("\n")
}

fn published(row: &Row) -> Option<String> {
    let published = row.published.as_ref()?;
    let over = row.gpu.as_ref().and_then(|gpu| gpu.over_the_papers_program);
    let occupancy =
        format!("{:.1}/{:.1}", published.achieved_occupancy_percent, published.theoretical_occupancy_percent);
    Some(format!(
        "{:<11} {:>8.0} {:>10.1} {:>9.0} {occupancy:>17} {:>9.2} {:>9.2} {:>12}",
        head(row),
        published.parallel_ms,
        published.serial_s,
        published.speed_up,
        published.branch_efficiency_percent,
        published.h200_ms,
        or_dash(over, 1)
    ))
}

fn measured(row: &Row) -> String {
    let gpu = |of: fn(&GpuRow) -> Option<f64>, digits| or_dash(row.gpu.as_ref().and_then(of), digits);
    let achieved = gpu(|gpu| gpu.profile.achieved_occupancy_percent, 1);
    let occupancy = format!("{achieved}/{}", gpu(|gpu| Some(gpu.theoretical_occupancy_percent), 1));
    format!(
        "{:<11} {:>8} {:>10.1} {:>9.1} {:>9} {:>7.1} {:>9} {occupancy:>17} {:>9} {:>6}",
        head(row),
        gpu(|gpu| Some(gpu.kernel_ms), 3),
        row.serial_ms,
        row.simd_ms,
        gpu(|gpu| Some(gpu.speed_up), 0),
        row.simd_speed_up,
        gpu(|gpu| Some(f64::from(gpu.registers)), 0),
        gpu(|gpu| gpu.profile.branch_efficiency_percent, 2),
        gpu(|gpu| gpu.profile.active_lanes, 1)
    )
}

fn head(row: &Row) -> String {
    format!("{}² {}", row.resolution, row.block)
}

fn or_dash(figure: Option<f64>, digits: usize) -> String {
    figure.map_or_else(|| "-".to_owned(), |figure| format!("{figure:.digits$}"))
}
