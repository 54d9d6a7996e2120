//! Stand-ins for NVIDIA's driver and run-time compiler, and programs on a machine that has them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

pub(crate) const DRIVER: &str = "libcuda.so";
pub(crate) const COMPILER: &str = "libnvrtc.so";
/// Sources of the stand-ins.
pub(crate) const SOURCES: [(&str, &str); 2] =
    [(DRIVER, include_str!("fake_cuda/driver.cpp")), (COMPILER, include_str!("fake_cuda/nvrtc.cpp"))];

/// Builds the stand-ins once; returns their folder, which has one folder for each, with its name.
pub(crate) fn stand_ins() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(concat!("fake_cuda-", env!("CARGO_CRATE_NAME")));
        // It does not exist before the first run.
        let _ = fs::remove_dir_all(&folder);
        for (library, source) in SOURCES {
            fs::create_dir_all(folder.join(library)).expect("a folder");
            let (compiler, text_path) = (std::env::var("CXX"), folder.join(format!("{library}.cpp")));
            fs::write(&text_path, source).expect("written");
            let compiled = Command::new(compiler.as_deref().unwrap_or("c++"))
                .args(["-std=c++17", "-O1", "-fPIC", "-shared", "-o"])
                .args([folder.join(library).join(library), text_path])
                .arg("-ldl")
                .output()
                .expect("a C++ compiler is installed");
            assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
        }
        folder
    })
}

/// The command on a machine with these libraries.
pub(crate) fn on_machine_with(libraries: &[&Path], mut command: Command) -> Command {
    command.env("LD_LIBRARY_PATH", std::env::join_paths(libraries).expect("plain"));
    command.env("SDFARM_CACHE", stand_ins().join("cache"));
    command.env("FAKE_NVRTC_STORE", stand_ins().join(COMPILER));
    for name in ["FAKE_CUDA", "FAKE_CUDA_COUNT", "FAKE_NVRTC", "FAKE_NVRTC_COUNT"] {
        command.env_remove(name);
    }
    command
}

/// The command on a machine with a working GPU.
pub(crate) fn on_machine_with_gpu(command: Command) -> Command {
    on_machine_with(&[&stand_ins().join(DRIVER), &stand_ins().join(COMPILER)], command)
}
