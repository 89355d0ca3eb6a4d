"""A store on object storage: a bucket of S3 beside a folder of copies."""
