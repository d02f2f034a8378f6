//! Computing on other machines: a worker serves a device, a client uses it as its own.
//!
//! Both sides speak Burn's remote protocol over an encrypted connection. The client knows the worker
//! by its ID, which the worker proves, and the worker lets in who presents its token. No relay or
//! directory of a third party is asked: the client dials the address that it is given.

use std::net::{SocketAddr, ToSocketAddrs};
use std::path::PathBuf;

use burn::remote::{EndpointId, IrohHost, RemoteHost};
use burn::server::{IrohIdentity, IrohRelays, IrohTransport, RemoteServer, TokenAuthorizer};
use burn::tensor::Device;

use crate::device::DeviceName;
use crate::error::{Error, Result};

/// The port that a worker listens on unless told otherwise.
pub const PORT: u16 = 7411;
/// The environment variable with the token that worker and client share.
pub const TOKEN_VARIABLE: &str = "TWINSIGHT_TOKEN";
/// Shortest token; a shorter one can be guessed.
const SHORTEST_TOKEN: usize = 16;

/// What a worker serves, and to whom.
#[derive(Debug, Clone)]
pub struct WorkerConfig {
    /// The devices, all of one kind.
    pub devices: Vec<DeviceName>,
    /// UDP port, on all of the machine's addresses.
    pub port: u16,
    /// File with the key behind the worker's ID, made where it is missing; without one the ID is
    /// another one at every start.
    pub identity: Option<PathBuf>,
    /// What clients must present.
    pub token: String,
}

/// A worker that is ready to serve.
pub struct Worker {
    server: RemoteServer,
    transport: IrohTransport,
    port: u16,
}

impl Worker {
    /// Opens the devices and reads the identity.
    ///
    /// # Errors
    /// A device that cannot be used, devices of several kinds, a token that is too short, or an
    /// identity that can be neither read nor made.
    pub fn new(config: &WorkerConfig) -> Result<Self> {
        check_token(&config.token)?;
        let devices = config
            .devices
            .iter()
            .map(DeviceName::open)
            .collect::<Result<Vec<Device>>>()?;
        let identity = match &config.identity {
            Some(path) => {
                IrohIdentity::load_or_create(path).map_err(Error::io("read or make", path))?
            }
            None => IrohIdentity::random(),
        };
        let authorizer = TokenAuthorizer::new(config.token.as_str())
            .map_err(|source| token_error(&source.to_string()))?;
        Ok(Self {
            server: RemoteServer::new(devices).with_authorizer(authorizer),
            transport: IrohTransport::new(identity)
                .with_relays(IrohRelays::Disabled)
                .with_port(config.port),
            port: config.port,
        })
    }

    /// What a client on a machine that reaches this one as `host` gives as its device.
    pub fn address(&self, host: &str) -> String {
        format!("remote:{}@{host}:{}", self.transport.id(), self.port)
    }

    /// Serves until the process is interrupted.
    ///
    /// # Errors
    /// A port that is taken, or a network that fails.
    pub fn serve(self) -> Result<()> {
        let port = self.port;
        self.server.serve(self.transport).map_err(|source| {
            Error::device(
                format!("worker on port {port}"),
                format!("cannot serve: {source}"),
                "give a free --port, and devices of one kind",
            )
        })
    }
}

/// Connects to a device of a worker; `address` is `ID@HOST:PORT`.
///
/// # Errors
/// An address that is none or cannot be resolved, a missing token, a worker that is not there or
/// refuses.
pub(crate) fn connect(address: &str, index: usize) -> Result<Device> {
    let name = format!("remote:{address}");
    let refuse = |problem: String, remedy: &str| Error::device(&name, problem, remedy);
    let (id, place) = address.split_once('@').unwrap_or_default();
    let id: EndpointId = id.parse().map_err(|source| {
        refuse(
            format!("\"{id}\" is not a worker's ID: {source}"),
            "copy the address that `twinsight worker` prints",
        )
    })?;
    let addresses: Vec<SocketAddr> = place
        .to_socket_addrs()
        .map_err(|source| {
            refuse(
                format!("\"{place}\" cannot be resolved: {source}"),
                "give the worker's host name or IP address, and its port",
            )
        })?
        .collect();
    let token = std::env::var(TOKEN_VARIABLE).unwrap_or_default();
    check_token(&token)?;
    let host = addresses.into_iter().fold(
        IrohHost::new(id).with_relays(IrohRelays::Disabled),
        IrohHost::with_address,
    );
    let host = RemoteHost::iroh(host).with_credential(token);
    Device::remote_options(&host)
        .device_index(index)
        .init()
        .map_err(|source| {
            refuse(
                format!("does not answer as it should: {source}"),
                "check that the worker runs, that its address and token are right, and that no \
                 firewall blocks its UDP port",
            )
        })
}

fn check_token(token: &str) -> Result<()> {
    if token.len() < SHORTEST_TOKEN {
        return Err(token_error(&format!(
            "has {} characters, fewer than {SHORTEST_TOKEN}",
            token.len()
        )));
    }
    Ok(())
}

fn token_error(problem: &str) -> Error {
    Error::value(
        format!("the token in {TOKEN_VARIABLE}"),
        problem,
        format!(
            "set the same one for worker and client, such as the output of `openssl rand -hex 16`: \
             export {TOKEN_VARIABLE}=..."
        ),
    )
}
