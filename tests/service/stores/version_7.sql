-- What the service's tables of version 7 were, with a token, a job and a draft.
BEGIN TRANSACTION;
CREATE TABLE tandem_audit (
	number INTEGER NOT NULL,
	at FLOAT NOT NULL,
	token VARCHAR(32) NOT NULL,
	who VARCHAR(200) NOT NULL,
	team VARCHAR(64),
	act VARCHAR(16) NOT NULL,
	job VARCHAR(32) NOT NULL,
	about TEXT NOT NULL,
	PRIMARY KEY (number)
);
CREATE TABLE tandem_deliveries (
	id VARCHAR(64) NOT NULL,
	webhook VARCHAR(32) NOT NULL,
	body TEXT NOT NULL,
	due FLOAT NOT NULL,
	attempts INTEGER NOT NULL,
	PRIMARY KEY (id)
);
CREATE TABLE tandem_draft_versions (
	draft VARCHAR(32) NOT NULL,
	number INTEGER NOT NULL,
	at FLOAT NOT NULL,
	who VARCHAR(200) NOT NULL,
	problem VARCHAR(64) NOT NULL,
	files TEXT NOT NULL,
	PRIMARY KEY (draft, number)
);
INSERT INTO "tandem_draft_versions" VALUES('cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd',1,1700000000.0,'ann','0000000000000000000000000000000000000000000000000000000000000000','[]');
CREATE TABLE tandem_drafts (
	id VARCHAR(32) NOT NULL,
	owner VARCHAR(32) NOT NULL,
	kind VARCHAR(16) NOT NULL,
	title VARCHAR(200) NOT NULL,
	version INTEGER NOT NULL,
	created FLOAT NOT NULL,
	changed FLOAT NOT NULL,
	job VARCHAR(32),
	sent INTEGER,
	PRIMARY KEY (id)
);
INSERT INTO "tandem_drafts" VALUES('cdcdcdcdcdcdcdcdcdcdcdcdcdcdcdcd','0123456789abcdef','draft','Vault',1,1700000000.0,1700000000.0,NULL,NULL);
CREATE TABLE tandem_element_jobs (
	job VARCHAR(32) NOT NULL,
	element VARCHAR(32) NOT NULL,
	role VARCHAR(16) NOT NULL,
	panel VARCHAR(32) NOT NULL,
	"like" VARCHAR(32),
	about TEXT NOT NULL,
	PRIMARY KEY (job)
);
CREATE TABLE tandem_events (
	job VARCHAR(32) NOT NULL,
	seq INTEGER NOT NULL,
	kind VARCHAR(16) NOT NULL,
	data TEXT NOT NULL,
	at FLOAT NOT NULL,
	PRIMARY KEY (job, seq)
);
CREATE TABLE tandem_files (
	job VARCHAR(32) NOT NULL,
	name VARCHAR(255) NOT NULL,
	sha VARCHAR(64) NOT NULL,
	size INTEGER NOT NULL,
	PRIMARY KEY (job, name)
);
CREATE TABLE tandem_jobs (
	id VARCHAR(32) NOT NULL,
	owner VARCHAR(32) NOT NULL,
	name VARCHAR(64) NOT NULL,
	digest VARCHAR(64) NOT NULL,
	"key" VARCHAR(64) NOT NULL,
	processes TEXT NOT NULL,
	state VARCHAR(16) NOT NULL,
	stage VARCHAR(64) NOT NULL,
	fraction FLOAT NOT NULL,
	issues TEXT NOT NULL,
	metrics TEXT NOT NULL,
	created FLOAT NOT NULL,
	started FLOAT,
	finished FLOAT,
	seconds FLOAT,
	attempts INTEGER NOT NULL,
	host VARCHAR(96),
	lease FLOAT,
	seq INTEGER NOT NULL,
	cancel INTEGER NOT NULL,
	from_store INTEGER NOT NULL,
	timeout_s FLOAT NOT NULL,
	memory_mb FLOAT NOT NULL,
	releases INTEGER NOT NULL,
	title VARCHAR(200) NOT NULL,
	tags TEXT NOT NULL,
	notes TEXT NOT NULL,
	label VARCHAR(200) NOT NULL,
	sought TEXT NOT NULL,
	turn FLOAT NOT NULL,
	PRIMARY KEY (id)
);
INSERT INTO "tandem_jobs" VALUES('abababababababababababababababab','0123456789abcdef','panel','0000000000000000000000000000000000000000000000000000000000000000','1111111111111111111111111111111111111111111111111111111111111111','["targets"]','infeasible','motion',1.0,'[]','{}',1790000000.0,NULL,1790000010.0,10.0,1,NULL,NULL,1,0,0,3600.0,4096.0,0,'Gewölbe 3','','','gewölbe 3','panel gewölbe 3',1790000000.0);
CREATE TABLE tandem_keys (
	owner VARCHAR(32) NOT NULL,
	hash VARCHAR(64) NOT NULL,
	number INTEGER NOT NULL,
	job VARCHAR(32) NOT NULL,
	content VARCHAR(64) NOT NULL,
	created FLOAT NOT NULL,
	PRIMARY KEY (owner, hash, number)
);
CREATE TABLE tandem_links (
	id VARCHAR(32) NOT NULL,
	job VARCHAR(32) NOT NULL,
	token VARCHAR(32) NOT NULL,
	who VARCHAR(200) NOT NULL,
	created FLOAT NOT NULL,
	expires FLOAT NOT NULL,
	PRIMARY KEY (id)
);
CREATE TABLE tandem_releases (
	job VARCHAR(32) NOT NULL,
	number INTEGER NOT NULL,
	token VARCHAR(32) NOT NULL,
	who VARCHAR(200) NOT NULL,
	at FLOAT NOT NULL,
	note TEXT NOT NULL,
	digest VARCHAR(64) NOT NULL,
	proof VARCHAR(64) NOT NULL,
	programs TEXT NOT NULL,
	withdrawn FLOAT,
	withdrawn_token VARCHAR(32),
	withdrawn_who VARCHAR(200),
	reason TEXT,
	PRIMARY KEY (job, number)
);
CREATE TABLE tandem_schema (
	version INTEGER NOT NULL,
	PRIMARY KEY (version)
);
INSERT INTO "tandem_schema" VALUES(7);
CREATE TABLE tandem_secrets (
	name VARCHAR(32) NOT NULL,
	value VARCHAR(64) NOT NULL,
	PRIMARY KEY (name)
);
CREATE TABLE tandem_sessions (
	hash VARCHAR(64) NOT NULL,
	token VARCHAR(32) NOT NULL,
	expires FLOAT NOT NULL,
	PRIMARY KEY (hash)
);
CREATE TABLE tandem_tokens (
	id VARCHAR(32) NOT NULL,
	name VARCHAR(64) NOT NULL,
	hash VARCHAR(64) NOT NULL,
	created FLOAT NOT NULL,
	revoked FLOAT,
	role VARCHAR(16) NOT NULL,
	team VARCHAR(64),
	expires FLOAT,
	PRIMARY KEY (id),
	UNIQUE (name),
	UNIQUE (hash)
);
INSERT INTO "tandem_tokens" VALUES('0123456789abcdef','ann','1c43f993b5b5c3be21ae858c67d08a0f93f54361f78d405bea67ebb495ccdbc8',1790000000.0,NULL,'release','shop',NULL);
CREATE TABLE tandem_webhooks (
	id VARCHAR(32) NOT NULL,
	owner VARCHAR(32) NOT NULL,
	url VARCHAR(500) NOT NULL,
	secret VARCHAR(128) NOT NULL,
	created FLOAT NOT NULL,
	told FLOAT,
	outcome VARCHAR(200),
	off FLOAT,
	PRIMARY KEY (id)
);
CREATE INDEX tandem_jobs_by_owner ON tandem_jobs (owner, created, id);
CREATE INDEX ix_tandem_jobs_key ON tandem_jobs ("key");
CREATE INDEX ix_tandem_jobs_state ON tandem_jobs (state);
CREATE INDEX ix_tandem_files_sha ON tandem_files (sha);
CREATE INDEX ix_tandem_element_jobs_element ON tandem_element_jobs (element);
CREATE INDEX ix_tandem_keys_job ON tandem_keys (job);
CREATE INDEX ix_tandem_webhooks_owner ON tandem_webhooks (owner);
CREATE INDEX ix_tandem_deliveries_due ON tandem_deliveries (due);
CREATE INDEX ix_tandem_deliveries_webhook ON tandem_deliveries (webhook);
CREATE INDEX ix_tandem_audit_token ON tandem_audit (token);
CREATE INDEX ix_tandem_audit_team ON tandem_audit (team);
CREATE INDEX ix_tandem_audit_job ON tandem_audit (job);
CREATE INDEX ix_tandem_links_job ON tandem_links (job);
CREATE INDEX ix_tandem_drafts_owner ON tandem_drafts (owner);
COMMIT;
