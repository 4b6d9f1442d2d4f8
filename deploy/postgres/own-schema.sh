#!/bin/sh
# Gives the service a role that owns the schema `equimesh` of the database `equimesh`, and nothing else. PostgreSQL's
# image runs it as its superuser when it makes a new volume. docs/how-to/upgrade.md runs it on the volume of release 0.2,
# whose tables it moves into the schema. It may be run again.
set -eu
psql --username postgres --dbname equimesh --set ON_ERROR_STOP=1 --no-psqlrc --quiet \
    --set password="$POSTGRES_PASSWORD" << 'SQL'
SET client_min_messages = warning;
SELECT 'CREATE ROLE equimesh' WHERE NOT EXISTS (SELECT FROM pg_roles WHERE rolname = 'equimesh') \gexec
ALTER ROLE equimesh LOGIN NOSUPERUSER NOCREATEDB NOCREATEROLE NOREPLICATION NOBYPASSRLS PASSWORD :'password';
REVOKE ALL ON DATABASE equimesh, postgres, template1 FROM PUBLIC;
GRANT CONNECT ON DATABASE equimesh TO equimesh;
REVOKE ALL ON SCHEMA public FROM PUBLIC;
-- A role finds the schema of its own name first.
CREATE SCHEMA IF NOT EXISTS equimesh;
ALTER SCHEMA equimesh OWNER TO equimesh;
SELECT format('ALTER TABLE public.%I SET SCHEMA equimesh', tablename) FROM pg_tables WHERE schemaname = 'public' \gexec
SELECT format('ALTER TABLE equimesh.%I OWNER TO equimesh', tablename) FROM pg_tables WHERE schemaname = 'equimesh' \gexec
-- The superuser has no password: it is reached through the socket in the container only.
ALTER ROLE postgres PASSWORD NULL;
SQL
