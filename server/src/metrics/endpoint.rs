//! `GET /metrics` and `GET /healthz` over plain HTTP/1.1, for whoever can reach the address: no names of tasks or clients and no
//! secrets are told. Few connections at a time, one request each, and each ends within a few seconds, whatever its
//! other end does.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{CACHE_CONTROL, CONTENT_TYPE};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::task::JoinHandle;

use super::Metrics;

/// Connections at a time; further ones are closed at once.
const CONNECTIONS: usize = 16;
/// From the connection to the end of the request's header.
const HEADER: Duration = Duration::from_secs(2);
/// From the connection to its end: a reader that is slower does not get the page.
const CONNECTION: Duration = Duration::from_secs(5);
/// A request's header may have so many bytes.
const HEADER_BYTES: usize = 16 * 1024;
/// After the system gave no connection, for want of file descriptors for example.
const AFTER_FAILURE: Duration = Duration::from_millis(100);
/// The worker's clock looks every few milliseconds; one that has not for so long does not brake either.
const CLOCK_STANDS: Duration = Duration::from_secs(1);
const TEXT: &str = "text/plain; version=0.0.4; charset=utf-8";

/// The endpoint while it listens; dropped, it is closed.
pub(crate) struct MetricsEndpoint {
    address: SocketAddr,
    listening: JoinHandle<()>,
}

impl MetricsEndpoint {
    /// Listens from now on. Fails when the address is taken.
    pub(crate) async fn open(address: SocketAddr, metrics: &Arc<Metrics>) -> std::io::Result<MetricsEndpoint> {
        let listener = TcpListener::bind(address).await?;
        let address = listener.local_addr()?;
        let listening = tokio::spawn(listen(listener, Arc::clone(metrics)));
        tracing::info!(%address, "metrics");
        Ok(MetricsEndpoint { address, listening })
    }

    /// Where it listens: the port is the one that was given by the system if 0 was asked for.
    pub(crate) fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for MetricsEndpoint {
    fn drop(&mut self) {
        self.listening.abort();
    }
}

async fn listen(listener: TcpListener, metrics: Arc<Metrics>) {
    let room = Arc::new(Semaphore::new(CONNECTIONS));
    loop {
        let stream = match listener.accept().await {
            Ok((stream, _)) => stream,
            Err(error) => {
                tracing::debug!(%error, "no connection for the metrics");
                tokio::time::sleep(AFTER_FAILURE).await;
                continue;
            }
        };
        let Ok(permit) = Arc::clone(&room).try_acquire_owned() else { continue };
        let metrics = Arc::clone(&metrics);
        tokio::spawn(async move {
            serve(stream, metrics).await;
            drop(permit);
        });
    }
}

async fn serve(stream: TcpStream, metrics: Arc<Metrics>) {
    let answer = service_fn(move |request| {
        let response = answer(&request, &metrics);
        async move { Ok::<_, Infallible>(response) }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEADER)
        .max_buf_size(HEADER_BYTES)
        .keep_alive(false)
        .serve_connection(TokioIo::new(stream), answer);
    match tokio::time::timeout(CONNECTION, connection).await {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::debug!(%error, "a reader of the metrics"),
        Err(_late) => tracing::debug!(limit = ?CONNECTION, "a reader of the metrics was too slow"),
    }
}

fn answer(request: &Request<Incoming>, metrics: &Metrics) -> Response<Full<Bytes>> {
    if request.method() != Method::GET {
        return response(StatusCode::METHOD_NOT_ALLOWED, "only GET\n");
    }
    // A worker that was fenced leaves with its session, and the next one follows.
    let Some(shared) = metrics.shown() else {
        return response(StatusCode::SERVICE_UNAVAILABLE, "no worker runs now\n");
    };
    match request.uri().path() {
        "/metrics" => match metrics.page(&shared) {
            Ok(page) => response(StatusCode::OK, page),
            Err(error) => response(StatusCode::INTERNAL_SERVER_ERROR, format!("{error}\n")),
        },
        "/healthz" if shared.clock_silence() > CLOCK_STANDS => {
            response(StatusCode::SERVICE_UNAVAILABLE, format!("the clock stands since {:?}\n", shared.clock_silence()))
        }
        "/healthz" => response(StatusCode::OK, "ok\n"),
        _ => response(StatusCode::NOT_FOUND, "there are /metrics and /healthz\n"),
    }
}

fn response(status: StatusCode, text: impl Into<Bytes>) -> Response<Full<Bytes>> {
    let mut response = Response::new(Full::new(text.into()));
    *response.status_mut() = status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, hyper::header::HeaderValue::from_static(TEXT));
    headers.insert(CACHE_CONTROL, hyper::header::HeaderValue::from_static("no-store"));
    response
}
