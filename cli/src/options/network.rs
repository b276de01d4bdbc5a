//! How a subcommand joins the network: alike for everything that talks to a service.

use std::path::PathBuf;

use anyhow::Context;
use clap::Args;
use domvs_client::{Client, ClientOptions, zenoh_config};
use domvs_proto::keys::Keys;

/// Where the others are.
#[derive(Args, Clone, Debug)]
pub struct NetworkOptions {
    /// A router or service to connect to, such as tcp/192.168.1.5:7447 [default: tcp/127.0.0.1:7447]
    #[arg(short = 'e', long = "endpoint", value_name = "ENDPOINT", help_heading = "Network options")]
    pub endpoints: Vec<String>,

    /// A Zenoh configuration file (JSON5)
    #[arg(long, value_name = "FILE", env = "ZENOH_CONFIG", help_heading = "Network options")]
    pub zenoh_config: Option<PathBuf>,

    /// First part of every key
    #[arg(long, value_name = "PREFIX", default_value = "domvs", help_heading = "Network options")]
    pub prefix: String,
}

impl NetworkOptions {
    /// The Zenoh configuration of a client.
    ///
    /// # Errors
    /// Fails when the file cannot be read or an endpoint is not one.
    pub fn config(&self) -> anyhow::Result<zenoh::Config> {
        Ok(zenoh_config(self.zenoh_config.as_deref(), &self.endpoints)?)
    }

    /// The keys under this prefix.
    ///
    /// # Errors
    /// Fails when the prefix is none.
    pub fn keys(&self) -> anyhow::Result<Keys> {
        Keys::new(&self.prefix).with_context(|| format!("--prefix {}", self.prefix))
    }

    /// Connects as the client `name`.
    ///
    /// # Errors
    /// Fails when nothing can be reached.
    pub async fn connect(&self, name: &str) -> anyhow::Result<Client> {
        let options =
            ClientOptions { prefix: self.prefix.clone(), zenoh: self.config()?, ..ClientOptions::named(name)? };
        Ok(Client::connect(options).await?)
    }
}
