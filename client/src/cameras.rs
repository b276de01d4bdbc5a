//! Cameras of our own format: what they say they are, and, of simulated ones, what they should see.

use std::time::Duration;

use domvs_proto::body;
use domvs_proto::keys::Name;
use domvs_proto::messages::CameraInfo;

use crate::client::Client;
use crate::frame::{OutgoingFrame, ReceivedFrame};
use crate::{ClientError, Silence};

impl Client {
    /// What a camera says it is; cameras repeat it once a second.
    ///
    /// # Errors
    /// [`ClientError::NoAnswer`] when it says nothing within `limit`, [`ClientError::BadAnswer`] when it is not readable.
    pub async fn camera_info(&self, camera: &Name, limit: Duration) -> Result<CameraInfo, ClientError> {
        let key = self.keys().camera_info(camera);
        let subscriber =
            self.session().declare_subscriber(&key).await.map_err(ClientError::session("listening", &key))?;
        let sample = tokio::time::timeout(limit, subscriber.recv_async()).await.ok().and_then(Result::ok);
        let sample = sample.ok_or_else(|| nobody(&key, limit))?;
        body::read(&sample.payload().to_bytes()).map_err(|error| ClientError::bad_answer(&key)(&error))
    }

    /// What a simulated camera would see from where it should be, ready to be set as a target.
    ///
    /// # Errors
    /// [`ClientError::NoAnswer`] when nobody tells within `limit`: a real camera does not know.
    pub async fn camera_desired(&self, camera: &Name, limit: Duration) -> Result<OutgoingFrame, ClientError> {
        let key = self.keys().camera_desired(camera);
        let replies = self.session().get(&key).timeout(limit).await.map_err(ClientError::session("asking", &key))?;
        let reply = replies.recv_async().await.ok().and_then(|reply| reply.into_result().ok());
        let sample = reply.ok_or_else(|| nobody(&key, limit))?;
        ReceivedFrame::from_sample(&key, &sample)?.into_outgoing()
    }
}

fn nobody(key: &str, waited: Duration) -> ClientError {
    ClientError::NoAnswer { key: key.to_owned(), waited, reason: Silence::Empty }
}
