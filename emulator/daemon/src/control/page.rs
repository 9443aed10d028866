//! The bench page: its files, and what a browser may do with them.

/// A file of the page.
#[derive(Debug, Clone, Copy)]
pub(super) struct File {
    pub path: &'static str,
    pub what: &'static str,
    pub content_type: &'static str,
    pub text: &'static str,
}

/// Scripts and styles of this server alone, nothing inline, no frame around it.
pub(super) const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; \
    img-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

macro_rules! files {
    ($($path:literal $what:literal $type:literal $text:expr;)*) => {
        &[$(File { path: $path, what: $what, content_type: $type, text: $text }),*]
    };
}

pub(super) const FILES: &[File] = files! {
    "/" "The bench page" "text/html; charset=utf-8" include_str!("page/index.html");
    "/page.css" "Its style" "text/css; charset=utf-8" include_str!("page/page.css");
    "/page.js" "Its script" "text/javascript; charset=utf-8" include_str!("page/page.js");
    "/dom.js" "Elements and questions" "text/javascript; charset=utf-8" include_str!("page/dom.js");
    "/charts.js" "Strip charts" "text/javascript; charset=utf-8" include_str!("page/charts.js");
    "/panels.js" "Faults and commands" "text/javascript; charset=utf-8" include_str!("page/panels.js");
    "/wire.js" "Frames taken apart" "text/javascript; charset=utf-8" include_str!("page/wire.js");
    "/icon.svg" "Its icon" "image/svg+xml" include_str!("page/icon.svg");
    "/chart.js" "Zoom, pan and values of charts" "text/javascript; charset=utf-8" geu_chart::SCRIPT;
    "/chart.css" "Style of charts" "text/css; charset=utf-8" geu_chart::STYLE;
    "/licences" "Its licence" "text/plain; charset=utf-8" include_str!("../../../../LICENSE");
};
