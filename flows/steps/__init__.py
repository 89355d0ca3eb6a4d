"""One file per verb: a request in, a result out; reads and keeps."""
