//! The tables that `sdfarm bench` prints.

use worker::bench::{BackEndReport, CompileReport, GpuReport, PointsReport, RenderReport};

use super::Reports;
use super::farm::FarmReport;
use crate::terminal::print_line;

/// Farms.
pub(super) fn farms(reports: &Reports) -> anyhow::Result<()> {
    for FarmReport { job, devices, jobs, latency_ms: [least, median, greatest], frames, frames_per_second } in
        &reports.farms
    {
        print_line(&format!("{job} on a farm of {}", devices.join(", ")))?;
        print_line(&format!("  POST to stored   median {median:.1} ms ({least:.1} to {greatest:.1}) of {jobs} jobs"))?;
        print_line(&format!("  animation        {frames} frames, {frames_per_second:.1} stored per second"))?;
    }
    Ok(())
}

/// Frames on a GPU.
pub(super) fn gpu_frames(reports: &Reports) -> anyhow::Result<()> {
    for report in &reports.gpu_renders {
        let GpuReport { job, gpu, block, registers, local_bytes, occupancy, .. } = report;
        let compiled = report.compile_ms.map_or("earlier (cached)".to_owned(), |ms| format!("{ms:.1} ms"));
        let share = report.peak_share.map_or_else(|| "-".to_owned(), |share| format!("{:.1} %", share * 100.0));
        print_line(&format!("{job} on {gpu}"))?;
        print_line(&format!("  program       compiled {compiled}, loaded in {:.1} ms", report.load_ms))?;
        print_line(&format!(
            "  resources     blocks {block}, {registers} registers, {local_bytes} bytes spilled, occupancy {:.0} %",
            occupancy * 100.0
        ))?;
        print_line(&format!(
            "  frame         kernels {:.3} ms (least {:.3}), longest launch {:.2} ms, pixels copied after {:.2} ms",
            report.kernel_ms, report.least_kernel_ms, report.longest_launch_ms, report.median_ms
        ))?;
        print_line(&format!(
            "  rates         {:.2} G rays/s, {:.1} M evaluations, {:.1} G evaluations/s, {share} of the fp32 peak\n",
            report.rays_per_second / 1e9,
            report.evaluations as f64 / 1e6,
            report.evaluations_per_second / 1e9
        ))?;
    }
    Ok(())
}

/// Distances without marching.
pub(super) fn points(reports: &Reports) -> anyhow::Result<()> {
    print_line("distances without marching, one thread")?;
    print_line(&format!("{:<20} {:<8} {:>10} {:>13}", "job", "simd", "M points/s", "range"))?;
    for report in &reports.points {
        let PointsReport { job, simd, least_points_per_second: least, greatest_points_per_second: greatest, .. } =
            report;
        let (median, range) = (report.points_per_second / 1e6, format!("{:.0}–{:.0}", least / 1e6, greatest / 1e6));
        print_line(&format!("{job:<20} {simd:<8} {median:>10.1} {range:>13}"))?;
    }
    Ok(())
}

/// Frames on CPUs.
pub(super) fn frames(reports: &Reports) -> anyhow::Result<()> {
    print_line("\nframes at their jobs' settings, rendered but not encoded")?;
    print_line(&format!(
        "{:<20} {:<8} {:>7} {:>10} {:>9} {:>9} {:>9} {:>16}",
        "job", "simd", "threads", "median ms", "least", "greatest", "M rays/s", "M evaluations/s"
    ))?;
    for report in &reports.renders {
        let RenderReport { job, simd, threads, median_ms, least_ms, greatest_ms, .. } = report;
        let (rays, evaluations) = (report.rays_per_second / 1e6, report.evaluations_per_second / 1e6);
        print_line(&format!(
            "{job:<20} {simd:<8} {threads:>7} {median_ms:>10.1} {least_ms:>9.1} {greatest_ms:>9.1} {rays:>9.2} {evaluations:>16.1}"
        ))?;
    }
    Ok(())
}

/// Compiling scenes.
pub(super) fn compile_times(reports: &Reports) -> anyhow::Result<()> {
    let Some(first) = reports.compile_times.first() else { return Ok(()) };
    let names: Vec<&str> = first.back_ends.iter().map(|back_end| back_end.simd).collect();
    print_line("compiling scenes, median ms, and KiB of machine code")?;
    let heads: Vec<String> = names.iter().map(|name| format!("{name:>10} {:>7}", "KiB")).collect();
    print_line(&format!("{:<24} {:>9} {}", "job", "recording", heads.join(" ")))?;
    let row = |name: &str, record_ms: f64, back_ends: Vec<(f64, Option<usize>)>| {
        let cells = back_ends.into_iter().map(|(ms, bytes)| {
            let size = bytes.map_or_else(|| "-".to_owned(), |bytes| format!("{:.1}", bytes as f64 / 1024.0));
            format!("{ms:>10.2} {size:>7}")
        });
        print_line(&format!("{name:<24} {record_ms:>9.2} {}", cells.collect::<Vec<_>>().join(" ")))
    };
    for CompileReport { job, record_ms, back_ends } in &reports.compile_times {
        let cells =
            back_ends.iter().map(|BackEndReport { prepare_ms, code_bytes, .. }| (prepare_ms.median, *code_bytes));
        row(job, record_ms.median, cells.collect())?;
    }
    let of_all = |name: &str, ms: fn(f64, f64) -> f64, bytes: fn(usize, usize) -> usize| {
        let all = &reports.compile_times;
        let record = all.iter().map(|report| report.record_ms.median).fold(0.0, ms);
        let cells = (0..names.len()).map(|place| {
            let back_ends = || all.iter().map(|report| &report.back_ends[place]);
            let size = back_ends().map(|back_end| back_end.code_bytes).reduce(|a, b| Some(bytes(a?, b?))).flatten();
            (back_ends().map(|back_end| back_end.prepare_ms.median).fold(0.0, ms), size)
        });
        row(name, record, cells.collect())
    };
    of_all("the largest", f64::max, usize::max)?;
    of_all("all together", |a, b| a + b, |a, b| a + b)
}
