//! Nothing to use: this package holds the tests of the running service, in `tests/service` over real Zenoh
//! sessions and in `python` as a stranger in another language sees it.
