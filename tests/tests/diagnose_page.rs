//! `geu diagnose --html`: a self-contained page, of an `explained` and of an `unexplained` recording.

use std::fs;
use std::process::Command;
use std::sync::LazyLock;

use geu_plant::{Gyro, IndependentModel, PlantedEffect};
use geu_tests::page::well_formed;
use geu_tests::{geu, give_way, skipped};

/// The diagnosis that two tests use.
static PIVOT_CLEARANCE: LazyLock<Diagnosed> = LazyLock::new(|| {
    let injected = PlantedEffect::new("pivot-clearance", &[Gyro::X], &[("clearance_arcsec", 11.5)]);
    Diagnosed::of(7, injected, &[])
});

/// Exit code, report and page of a diagnosed recording.
struct Diagnosed {
    code: Option<i32>,
    report: String,
    page: String,
}

impl Diagnosed {
    fn of(seed: u64, injected: PlantedEffect, further: &[&str]) -> Diagnosed {
        give_way();
        let directory = tempfile::tempdir().expect("a directory");
        let at = |name: &str| directory.path().join(name).display().to_string();
        let recording = IndependentModel { duration_s: 5400.0, ..IndependentModel::new(seed, vec![injected]) }.record();
        for (name, text) in [("link.log", &recording.link), ("reference.csv", &recording.reference)] {
            fs::write(at(name), text).expect("written");
        }
        // A list that begins and ends within the recording, on its time scale.
        fs::write(at("manoeuvres.csv"), "manoeuvre,start_s,end_s\n<first> & only,1795000100,1795003000\n")
            .expect("written");
        let mut command = geu();
        command.args([
            "diagnose",
            "--verbose",
            "--link",
            &at("link.log"),
            "--reference",
            &at("reference.csv"),
            "--html",
            &at("page.html"),
        ]);
        command.args(further.iter().map(|text| text.replace("{}", &directory.path().display().to_string())));
        // A cache of its own.
        let output = command.env("XDG_CACHE_HOME", at("cache")).output().expect("geu starts");
        let page = fs::read_to_string(at("page.html"))
            .unwrap_or_else(|error| panic!("no page: {error}: {}", String::from_utf8_lossy(&output.stderr)));
        let report = String::from_utf8_lossy(&output.stdout).into_owned();
        Diagnosed { code: output.status.code(), report, page }
    }

    /// Asserts what each page contains.
    fn assert_whole(&self) {
        let tags = well_formed(&self.page);
        assert!(tags.iter().all(|tag| !["script", "link", "img", "iframe", "a"].contains(&tag.as_str())));
        for outside in ["://", "src=", "href=", "url(", "@import"] {
            assert!(!self.page.contains(outside), "{outside}");
        }
        for title in [
            "Found",
            "Residuals before and after",
            "Manoeuvres",
            "Residual by variable",
            "Search",
            "Alternatives",
            "Cross-validation",
            "Exact checks",
            "Provenance",
        ] {
            assert!(self.page.contains(&format!("<h2>{title}</h2>")), "{title}");
        }
        for gyro in ["GYRX", "GYRY", "GYRZA", "GYRZB"] {
            let chart = self.chart(&format!("Residual of {gyro} before and after, arcsec over seconds"));
            for class in ["before", "after", "window"] {
                assert!(chart.contains(&format!("class=\"{class}\"")), "{gyro} {class}");
            }
            let bars = self.chart(&format!("Gap of {gyro} in each manoeuvre before and after, arcsec"));
            assert!(
                bars.contains("class=\"before\"") && bars.contains("class=\"after\"") && bars.contains("arcsec rms")
            );
        }
        // The page states each finding as the report does.
        let mut facts: Vec<String> = Vec::new();
        let effects = self.report.lines().take_while(|line| !["unexplained", "exact checks"].contains(line));
        for line in effects.filter(|line| line.starts_with("    ")) {
            match line.trim().split_once("  ") {
                Some(_) => facts.push(line.trim().to_owned()),
                // A value continues at the column of the values.
                None => *facts.last_mut().expect("a fact") += &format!(" {}", line.trim()),
            }
        }
        for fact in facts {
            let (label, value) = fact.split_once("  ").expect("a label and a value");
            let item = format!("<li>{label}: {}</li>", value.trim().replace('>', "&gt;"));
            assert!(self.page.contains(&item), "{item}");
        }
        assert!(!self.page.contains("NaN") && !self.page.contains("inf"), "a number that is none");
    }

    /// The chart with this label, with the nested `svg` that clips it.
    fn chart(&self, label: &str) -> &str {
        let start = self.page.find(&format!("aria-label=\"{label}\">")).unwrap_or_else(|| panic!("no {label}"));
        let rest = &self.page[start..];
        &rest[..rest.find("</figure>").expect("an end")]
    }

    /// The search table of a round.
    fn round(&self, number: usize) -> &str {
        let start = self.page.find(&format!("<h3>Round {number}: ")).unwrap_or_else(|| panic!("no round {number}"));
        let rest = &self.page[start..];
        &rest[..rest.find("</table>").expect("an end")]
    }
}

#[test]
fn a_pivot_clearance_is_shown_with_both_residuals_search_and_segments() {
    let diagnosed = &*PIVOT_CLEARANCE;
    assert_eq!(diagnosed.code, Some(0), "{}", diagnosed.report);
    diagnosed.assert_whole();
    let page = &diagnosed.page;
    assert!(page.contains("<strong>explained</strong>: the residual is noise with the effects and corrections below."));
    assert!(page.contains("<li>GYRX: pivot-clearance\n<ul>\n<li>clearance_arcsec: 11."), "the effect found");
    assert!(diagnosed.report.contains("\n  GYRX: pivot-clearance\n    clearance_arcsec  "), "{}", diagnosed.report);
    assert!(diagnosed.report.lines().all(|line| line.chars().count() <= 100), "{}", diagnosed.report);
    let first = diagnosed.round(1);
    assert!(first.starts_with("<h3>Round 1: added pivot-clearance</h3>"), "{first}");
    assert!(first.contains("<b>pivot-clearance</b>") && first.contains("<td>added</td>"), "{first}");
    // The slews about Y show the effect until it is in the model.
    assert!(page.contains(" turn about Y at +720 arcsec/s</th>"));
    let before = diagnosed.chart("Residual of GYRX by variable before, over seconds");
    let after = diagnosed.chart("Residual of GYRX by variable after, over seconds");
    // Without the effect there is at most a cell; ten show the effect.
    let count = |chart: &str| chart.matches("class=\"heat ").count();
    assert!(
        before.contains("strong") && count(before) > 10 * count(after).max(1),
        "{} {}",
        count(before),
        count(after)
    );
    assert!(
        diagnosed.report.contains("significant variables of the residual, in sigmas before and after\n  GYRX along ")
    );
}

#[test]
fn a_page_is_drawn_by_a_browser() {
    let has = |name: &&str| Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success());
    let Some(browser) = ["chromium", "chromium-browser", "google-chrome"].into_iter().find(has) else {
        return skipped("no Chromium is installed, the page is not drawn");
    };
    let directory = tempfile::tempdir().expect("a directory");
    let [page, image] = ["page.html", "page.png"].map(|name| directory.path().join(name));
    fs::write(&page, &PIVOT_CLEARANCE.page).expect("written");
    let show = |option: &str| {
        let shown = Command::new(browser)
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--hide-scrollbars",
                "--window-size=1280,4000",
                option,
            ])
            .arg(format!("--user-data-dir={}", directory.path().join("browser").display()))
            .arg(&page)
            .output()
            .expect("the browser starts");
        assert!(shown.status.success(), "{}", String::from_utf8_lossy(&shown.stderr));
        String::from_utf8_lossy(&shown.stdout).into_owned()
    };
    // Each chart can have the keyboard focus.
    let document = show("--dump-dom");
    let charts = document.split("<svg class=\"chart\"").skip(1);
    assert!(charts.clone().count() >= 8, "{document}");
    assert!(
        charts.map(|chart| chart.split('>').next()).all(|tag| tag.is_some_and(|tag| tag.contains("tabindex=\"0\"")))
    );
    show(&format!("--screenshot={}", image.display()));
    let bytes = fs::read(image).expect("an image");
    assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 50_000, "{} bytes", bytes.len());
}

#[test]
fn a_backlash_ends_unexplained_with_its_interval_in_the_residual() {
    backlash_ends_unexplained(8.0);
}

#[test]
#[ignore = "a minute in a release"]
fn a_large_backlash_ends_unexplained_with_its_interval_in_the_residual() {
    backlash_ends_unexplained(30.0);
}

fn backlash_ends_unexplained(play_arcsec: f64) {
    let injected = PlantedEffect::new("count-backlash", &[Gyro::Y], &[("play_arcsec", play_arcsec)]);
    let diagnosed = Diagnosed::of(8, injected, &["--manoeuvres", "{}/manoeuvres.csv"]);
    assert_eq!(diagnosed.code, Some(3), "{}", diagnosed.report);
    diagnosed.assert_whole();
    assert!(
        diagnosed
            .page
            .contains("<strong>unexplained</strong>: no effect of the model explains the rest of the residual.")
    );
    let chart = diagnosed.chart("Residual of GYRY before and after, arcsec over seconds");
    assert!(chart.contains("class=\"left\"") && chart.contains("<title>left unexplained, "));
    assert!(diagnosed.page.contains("Left unexplained: GYRY"));
    // The list's manoeuvre has its name of the list.
    assert!(diagnosed.page.contains("<th scope=\"row\">1 &lt;first&gt; &amp; only</th><td>100</td><td>2900</td>"));
}
