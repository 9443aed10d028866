//! Access control: rejects pages of other sites, rebound host names and requests without the token.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};

use axum::body::HttpBody;
use axum::extract::{Query, Request};
use axum::http::{HeaderMap, Method, StatusCode, Uri, header, uri::Authority};
use constant_time_eq::constant_time_eq;

use super::answer::ApiError;
use super::page;

/// Checks of every request before its handler.
#[derive(Debug, Clone)]
pub(super) struct Guard {
    /// Address of the listener.
    pub address: SocketAddr,
    /// Token required for everything but the page.
    pub token: Option<String>,
}

impl Guard {
    /// Returns the error of a request that is not permitted.
    pub fn check(&self, request: &Request) -> Result<(), ApiError> {
        let headers = request.headers();
        // The files of the page contain no secret and change nothing.
        let is_open = page::FILES.iter().any(|file| file.path == request.uri().path());
        let host = self.host(headers, request.uri())?;
        if let Some(origin) = headers.get(header::ORIGIN)
            && origin.as_bytes() != format!("http://{host}").as_bytes()
        {
            let message = format!("Origin: expected http://{host} or none, got {origin:?}: another site's page");
            return Err(ApiError(StatusCode::FORBIDDEN, message));
        }
        // Also sent with requests without Origin, such as those of images.
        let site = headers.get("sec-fetch-site").filter(|site| *site != "same-origin" && *site != "none");
        if let Some(site) = site.filter(|_| !is_open) {
            let message = format!("Sec-Fetch-Site: expected same-origin or none, got {site:?}");
            return Err(ApiError(StatusCode::FORBIDDEN, message));
        }
        if !matches!(*request.method(), Method::GET | Method::HEAD) && !request.body().is_end_stream() {
            is_json(headers)?;
        }
        match &self.token {
            Some(token) if !is_open => has_token(token, headers, request.uri()),
            _ => Ok(()),
        }
    }

    /// Host and port that the client addressed. A foreign name that resolves to this machine would make a foreign page
    /// same-origin (DNS rebinding); only addresses of this server and `localhost` are accepted.
    fn host<'a>(&self, headers: &'a HeaderMap, uri: &Uri) -> Result<&'a str, ApiError> {
        let mut hosts = headers.get_all(header::HOST).iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else {
            let message = "Host: expected one such header, got none or several";
            return Err(ApiError(StatusCode::BAD_REQUEST, message.to_owned()));
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
            let message = format!("Host: expected the address of this server ({address}) or localhost, got {host:?}");
            return Err(ApiError(StatusCode::FORBIDDEN, message));
        }
        Ok(text)
    }
}

/// A form of another site cannot send this content type without a preflight request.
fn is_json(headers: &HeaderMap) -> Result<(), ApiError> {
    let given = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let essence = given.split(';').next().unwrap_or_default().trim();
    if essence.eq_ignore_ascii_case("application/json") {
        return Ok(());
    }
    let message = format!("Content-Type: expected application/json, got {given:?}");
    Err(ApiError(StatusCode::UNSUPPORTED_MEDIA_TYPE, message))
}

/// Checks the token. An event stream of a page has no headers of its own, so the query may contain it too.
fn has_token(token: &str, headers: &HeaderMap, uri: &Uri) -> Result<(), ApiError> {
    let bearer = headers.get(header::AUTHORIZATION).and_then(|value| value.as_bytes().strip_prefix(b"Bearer "));
    let query = Query::<HashMap<String, String>>::try_from_uri(uri).ok();
    let in_query = query.as_ref().and_then(|query| query.get("token")).map(|token| token.as_bytes());
    if [bearer, in_query].into_iter().flatten().any(|given| constant_time_eq(given, token.as_bytes())) {
        return Ok(());
    }
    let message = "expected the token of the emulator, as Authorization: Bearer TOKEN or ?token=TOKEN";
    let got = if bearer.or(in_query).is_some() { "another" } else { "none" };
    Err(ApiError(StatusCode::UNAUTHORIZED, format!("{message}, got {got}")))
}
