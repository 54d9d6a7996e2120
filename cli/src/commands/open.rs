//! `sdfarm open`: starts a browser on a farm's page.

use std::env;
use std::process::Stdio;
use std::time::Duration;

use clap::Args;
use tokio::process::Command;
use tokio::time::timeout;

use crate::arguments::ServerArguments;
use crate::terminal::{print_line, print_note};

/// Programs that open an address in the user's browser: of the desktop, of macOS, of Linux under Windows.
const OPENERS: [&str; 3] = ["xdg-open", "open", "wslview"];
/// Variables; one of them is set where a window can be shown.
const DISPLAYS: [&str; 4] = ["DISPLAY", "WAYLAND_DISPLAY", "WSL_DISTRO_NAME", "__CF_USER_TEXT_ENCODING"];
/// Time after which a program that still runs is a browser that the user sees.
const START_TIMEOUT: Duration = Duration::from_secs(2);

/// Arguments of `open`.
#[derive(Debug, Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    server: ServerArguments,
}

/// Opens the page; without a browser, the printed address is what remains to do.
pub(crate) async fn run(arguments: Arguments) -> anyhow::Result<()> {
    let client = arguments.server.client()?;
    // A browser would show only that nothing answers, not how to start a farm.
    if let Err(error) = client.ready().await
        && error.code().is_none()
    {
        return Err(error.into());
    }
    let address = format!("{}/", client.server().trim_end_matches('/'));
    if !start_browser(&address).await {
        print_note("no browser could be started here: open this address in one");
    }
    print_line(&address)
}

/// Starts the first browser that can be started; `$BROWSER` has precedence.
async fn start_browser(address: &str) -> bool {
    let chosen = env::var("BROWSER").ok().filter(|program| !program.is_empty());
    let has_display = DISPLAYS.iter().any(|name| env::var_os(name).is_some());
    let openers = OPENERS.iter().filter(|_| has_display).map(|program| (*program).to_owned());
    for program in chosen.into_iter().chain(openers) {
        let mut command = Command::new(program);
        command.arg(address).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        let Ok(mut browser) = command.spawn() else { continue };
        match timeout(START_TIMEOUT, browser.wait()).await {
            Ok(Ok(status)) if !status.success() => {}
            Ok(_) | Err(_) => return true,
        }
    }
    false
}
