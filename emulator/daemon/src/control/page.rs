//! Files of the bench page and its content security policy.

/// A file of the page.
#[derive(Debug, Clone, Copy)]
pub(super) struct File {
    pub path: &'static str,
    pub summary: &'static str,
    pub content_type: &'static str,
    pub text: &'static str,
}

/// Only scripts and styles of this server, none inline, and no embedding in another page.
pub(super) const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

macro_rules! files {
    ($($path:literal $summary:literal $type:literal $text:expr;)*) => {
        &[$(File { path: $path, summary: $summary, content_type: $type, text: $text }),*]
    };
}

pub(super) const FILES: &[File] = files! {
    "/" "The bench page" "text/html; charset=utf-8" include_str!("page/index.html");
    "/page.css" "Style of the bench page" "text/css; charset=utf-8" include_str!("page/page.css");
    "/page.js" "Script of the bench page" "text/javascript; charset=utf-8" include_str!("page/page.js");
    "/dom.js" "Elements and requests" "text/javascript; charset=utf-8" include_str!("page/dom.js");
    "/charts.js" "Strip charts" "text/javascript; charset=utf-8" include_str!("page/charts.js");
    "/panels.js" "Faults and commands" "text/javascript; charset=utf-8" include_str!("page/panels.js");
    "/wire.js" "Fields of frames" "text/javascript; charset=utf-8" include_str!("page/wire.js");
    "/icon.svg" "Icon" "image/svg+xml" include_str!("page/icon.svg");
    "/chart.js" "Zoom, pan and values of charts" "text/javascript; charset=utf-8" geu_chart::SCRIPT;
    "/chart.css" "Style of charts" "text/css; charset=utf-8" geu_chart::STYLE;
    "/licences" "Licence" "text/plain; charset=utf-8" include_str!("../../../../LICENSE");
};
