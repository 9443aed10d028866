//! Who may ask: no page of another site, no name that was made to lead here, nobody without the token.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};

use axum::body::HttpBody;
use axum::extract::{Query, Request};
use axum::http::{HeaderMap, Method, StatusCode, Uri, header, uri::Authority};
use constant_time_eq::constant_time_eq;

use super::answer::ApiError;
use super::page;

/// What is asked of every request before anything else.
#[derive(Debug, Clone)]
pub(super) struct Guard {
    /// The address that is listened at.
    pub address: SocketAddr,
    /// What wants to be shown for everything but the page.
    pub token: Option<String>,
}

impl Guard {
    /// Whether the request may be answered.
    pub fn check(&self, request: &Request) -> Result<(), ApiError> {
        let headers = request.headers();
        // The page itself holds no secret and does nothing.
        let is_open = page::FILES.iter().any(|file| file.path == request.uri().path());
        let host = self.host(headers, request.uri())?;
        if let Some(origin) = headers.get(header::ORIGIN)
            && origin.as_bytes() != format!("http://{host}").as_bytes()
        {
            return Err(forbidden(format!(
                "Origin: expected http://{host} or none, got {origin:?}: another site's page"
            )));
        }
        // Tells of requests too that carry no Origin, as for a picture.
        let site = headers.get("sec-fetch-site").filter(|site| *site != "same-origin" && *site != "none");
        if let Some(site) = site.filter(|_| !is_open) {
            return Err(forbidden(format!("Sec-Fetch-Site: expected same-origin or none, got {site:?}")));
        }
        if !matches!(*request.method(), Method::GET | Method::HEAD) && !request.body().is_end_stream() {
            is_json(headers)?;
        }
        match &self.token {
            Some(token) if !is_open => is_shown(token, headers, request.uri()),
            _ => Ok(()),
        }
    }

    /// The host that the client believes to speak to, with its port. A name could have been made to lead here by
    /// somebody whose page then counts as ours; an address that is ours, or this machine's own name for itself, cannot.
    fn host<'a>(&self, headers: &'a HeaderMap, uri: &Uri) -> Result<&'a str, ApiError> {
        let mut hosts = headers.get_all(header::HOST).iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else {
            return Err(ApiError(
                StatusCode::BAD_REQUEST,
                "Host: expected one such header, got none or several".to_owned(),
            ));
        };
        let own = |host: &str| {
            let name = host.trim_start_matches('[').trim_end_matches(']');
            name.eq_ignore_ascii_case("localhost")
                || name
                    .parse::<IpAddr>()
                    .is_ok_and(|ip| ip.is_loopback() || ip == self.address.ip() || self.address.ip().is_unspecified())
        };
        let text = host.to_str().unwrap_or_default();
        let is_own = !text.contains('@') && text.parse::<Authority>().is_ok_and(|authority| own(authority.host()));
        if !is_own || !uri.host().is_none_or(own) {
            let address = self.address;
            return Err(forbidden(format!(
                "Host: expected the address of this server ({address}) or localhost, got {host:?}"
            )));
        }
        Ok(text)
    }
}

fn forbidden(message: String) -> ApiError {
    ApiError(StatusCode::FORBIDDEN, message)
}

/// Another site's form cannot send this type unasked.
fn is_json(headers: &HeaderMap) -> Result<(), ApiError> {
    let given = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let essence = given.split(';').next().unwrap_or_default().trim();
    if essence.eq_ignore_ascii_case("application/json") {
        return Ok(());
    }
    let message = format!("WireData-Type: expected application/json, got {given:?}");
    Err(ApiError(StatusCode::UNSUPPORTED_MEDIA_TYPE, message))
}

/// A page's event stream has no headers of its own, so the token may stand in the query.
fn is_shown(token: &str, headers: &HeaderMap, uri: &Uri) -> Result<(), ApiError> {
    let bearer = headers.get(header::AUTHORIZATION).and_then(|value| value.as_bytes().strip_prefix(b"Bearer "));
    let query = Query::<HashMap<String, String>>::try_from_uri(uri).ok();
    let asked = query.as_ref().and_then(|query| query.get("token")).map(|token| token.as_bytes());
    if [bearer, asked].into_iter().flatten().any(|shown| constant_time_eq(shown, token.as_bytes())) {
        return Ok(());
    }
    let message = "expected the token of the emulator, as Authorization: Bearer TOKEN or ?token=TOKEN";
    let got = if bearer.or(asked).is_some() { "another" } else { "none" };
    Err(ApiError(StatusCode::UNAUTHORIZED, format!("{message}, got {got}")))
}
