//! The byte stream to one client: both threads write to it, the runtime waits for it.

use std::io;
use std::ops::Deref;
use std::os::fd::{AsFd, AsRawFd, OwnedFd, RawFd};
use std::sync::Arc;

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use nix::unistd;
use tokio::io::unix::{AsyncFd, AsyncFdReadyGuard};

#[cfg(test)]
use crate::simulation::port as simulated;

/// A byte stream, without blocking; clones share it.
#[derive(Clone)]
pub(crate) enum Port {
    Device(Arc<OwnedFd>),
    #[cfg(test)]
    Simulated(simulated::Port),
}

impl Port {
    pub fn new(device: OwnedFd) -> Port {
        Port::Device(Arc::new(device))
    }

    pub fn write(&self, bytes: &[u8]) -> nix::Result<usize> {
        match self {
            Port::Device(device) => unistd::write(device, bytes),
            #[cfg(test)]
            Port::Simulated(port) => port.write(bytes),
        }
    }

    fn read(&self, bytes: &mut [u8]) -> nix::Result<usize> {
        match self {
            Port::Device(device) => unistd::read(device, bytes),
            #[cfg(test)]
            Port::Simulated(port) => port.read(bytes),
        }
    }

    /// State in the kernel: input, hung up, failed.
    pub fn state(&self) -> PollFlags {
        match self {
            Port::Device(device) => {
                let mut polled = [PollFd::new(device.as_fd(), PollFlags::POLLIN)];
                let is_polled = poll(&mut polled, PollTimeout::ZERO).is_ok();
                polled[0].revents().filter(|_| is_polled).unwrap_or(PollFlags::empty())
            }
            #[cfg(test)]
            Port::Simulated(port) => port.state(),
        }
    }
}

/// A byte stream that the runtime watches.
pub(crate) struct WatchedPort {
    pub port: Port,
    watch: Watch,
}

enum Watch {
    Device(AsyncFd<Watched<Arc<OwnedFd>>>),
    #[cfg(test)]
    Simulated(simulated::Watch),
}

impl WatchedPort {
    pub fn new(port: Port) -> io::Result<WatchedPort> {
        let watch = match &port {
            Port::Device(device) => Watch::Device(Watched::new(device.clone())?),
            #[cfg(test)]
            Port::Simulated(simulated) => Watch::Simulated(simulated.watch()),
        };
        Ok(WatchedPort { port, watch })
    }

    /// Reads available bytes, and waits for the first; 0 at the end of the stream, or after a hang-up.
    pub async fn read(&self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            let mut ready = match &self.watch {
                Watch::Device(watch) => Ready::Device(watch.readable().await?),
                #[cfg(test)]
                Watch::Simulated(watch) => Ready::Simulated(watch.readable().await),
            };
            let is_hung_up = ready.is_read_hung_up();
            match self.port.read(bytes) {
                Err(Errno::EAGAIN) => ready.clear(),
                result => return Ok(result?),
            }
            // A pty that was reopened at once: the hang-up stays in the readiness until a new one.
            if is_hung_up {
                return Ok(0);
            }
        }
    }

    pub async fn writable(&self) -> io::Result<Ready<'_>> {
        Ok(match &self.watch {
            Watch::Device(watch) => Ready::Device(watch.writable().await?),
            #[cfg(test)]
            Watch::Simulated(watch) => Ready::Simulated(watch.writable().await),
        })
    }
}

/// Readiness that the runtime has seen; it may be outdated.
pub(crate) enum Ready<'a> {
    Device(AsyncFdReadyGuard<'a, Watched<Arc<OwnedFd>>>),
    #[cfg(test)]
    Simulated(simulated::Ready<'a>),
}

impl Ready<'_> {
    fn is_read_hung_up(&self) -> bool {
        match self {
            Ready::Device(guard) => guard.ready().is_read_closed(),
            #[cfg(test)]
            Ready::Simulated(ready) => ready.is_hung_up(),
        }
    }

    pub fn is_hung_up(&self) -> bool {
        match self {
            Ready::Device(guard) => guard.ready().is_write_closed(),
            #[cfg(test)]
            Ready::Simulated(ready) => ready.is_hung_up(),
        }
    }

    /// Forgets it until the kernel reports it again; a hang-up stays.
    pub fn clear(&mut self) {
        match self {
            Ready::Device(guard) => guard.clear_ready(),
            #[cfg(test)]
            Ready::Simulated(ready) => ready.clear(),
        }
    }

    pub fn retain(&mut self) {
        match self {
            Ready::Device(guard) => guard.retain_ready(),
            #[cfg(test)]
            Ready::Simulated(_) => {}
        }
    }
}

/// A descriptor that the runtime watches.
pub(crate) struct Watched<T>(T);

impl<T: AsFd> Watched<T> {
    pub fn new(owner: T) -> io::Result<AsyncFd<Watched<T>>> {
        // SAFETY: the owner keeps its descriptor open, and the same, during the registration.
        Ok(unsafe { AsyncFd::register(Watched(owner)) }?)
    }
}

impl<T: AsFd> AsRawFd for Watched<T> {
    fn as_raw_fd(&self) -> RawFd {
        self.0.as_fd().as_raw_fd()
    }
}

impl<T> Deref for Watched<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.0
    }
}
