//! The lab's certificate authority: ECDSA over P-256 through `ring`, the same library that Zenoh's TLS uses.
//!
//! Only the router's certificate is good for being connected to, and only for its own addresses; the others' are good for connecting only.
//! So the key of a camera that was carried away cannot stand for the router.

use std::time::{Duration, SystemTime};

use anyhow::{Context, ensure};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use domvs_proto::keys::Name;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, KeyUsagePurpose,
    PublicKeyData,
};

use super::ROUTER;

/// The common name of every lab's authority; which lab it is, its key says.
const AUTHORITY: &str = "Domvs lab CA";
/// Ten years, days: the authority outlives what it signs.
const AUTHORITY_DAYS: u32 = 3650;
const DAY: Duration = Duration::from_secs(24 * 60 * 60);
/// Clocks in a lab differ; a certificate is good from this long ago.
const BACKDATED: Duration = Duration::from_secs(60 * 60);

/// Signs the lab's certificates.
pub struct Authority {
    key: KeyPair,
}

/// A certificate and its key, PEM.
pub struct Identity {
    /// For everybody to see.
    pub certificate: String,
    /// For its owner alone.
    pub key: String,
}

impl Authority {
    /// A new one.
    ///
    /// # Errors
    /// Fails when the system gives no random numbers.
    pub fn new() -> anyhow::Result<Authority> {
        Ok(Authority { key: KeyPair::generate()? })
    }

    /// The one of these two files.
    ///
    /// # Errors
    /// Fails when the key is none, or not the certificate's.
    pub fn read(certificate: &str, key: &str) -> anyhow::Result<Authority> {
        let key = KeyPair::from_pem(key).context("ca.key.pem is not a private key")?;
        let body: String = certificate.lines().filter(|line| !line.starts_with("-----")).map(str::trim).collect();
        let body = BASE64_STANDARD.decode(body).context("ca.pem is not a certificate")?;
        let public = key.subject_public_key_info();
        ensure!(body.windows(public.len()).any(|part| part == public), "ca.key.pem is not the key of ca.pem");
        Ok(Authority { key })
    }

    /// Its own certificate, PEM.
    ///
    /// # Errors
    /// Fails when signing does.
    pub fn certificate(&self) -> anyhow::Result<String> {
        Ok(authority_params().self_signed(&self.key)?.pem())
    }

    /// Its own key, PEM.
    pub fn key(&self) -> String {
        self.key.serialize_pem()
    }

    /// The router's identity, for these host names and addresses.
    ///
    /// # Errors
    /// Fails when a host is none.
    pub fn router(&self, hosts: &[String], days: u32) -> anyhow::Result<Identity> {
        let params = CertificateParams::new(hosts)
            .with_context(|| format!("expected host names or addresses, got {hosts:?}"))?;
        self.sign(params, ROUTER, ExtendedKeyUsagePurpose::ServerAuth, days)
    }

    /// A member's identity.
    ///
    /// # Errors
    /// Fails when the system gives no random numbers.
    pub fn member(&self, name: &Name, days: u32) -> anyhow::Result<Identity> {
        self.sign(CertificateParams::default(), name.as_str(), ExtendedKeyUsagePurpose::ClientAuth, days)
    }

    fn sign(
        &self,
        mut params: CertificateParams,
        name: &str,
        purpose: ExtendedKeyUsagePurpose,
        days: u32,
    ) -> anyhow::Result<Identity> {
        params.is_ca = IsCa::ExplicitNoCa;
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![purpose];
        params.use_authority_key_identifier_extension = true;
        let params = dated(named(params, name), days);
        let key = KeyPair::generate()?;
        let issuer = Issuer::new(authority_params(), &self.key);
        Ok(Identity { certificate: params.signed_by(&key, &issuer)?.pem(), key: key.serialize_pem() })
    }
}

fn authority_params() -> CertificateParams {
    let mut params = CertificateParams::default();
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    dated(named(params, AUTHORITY), AUTHORITY_DAYS)
}

fn named(mut params: CertificateParams, name: &str) -> CertificateParams {
    params.distinguished_name = rcgen::DistinguishedName::new();
    params.distinguished_name.push(DnType::CommonName, name);
    params
}

fn dated(mut params: CertificateParams, days: u32) -> CertificateParams {
    let now = SystemTime::now();
    params.not_before = (now - BACKDATED).into();
    params.not_after = (now + DAY * days).into();
    params
}
