"""Checks the compose files, the balancer and the Dockerfiles without a container engine: known keys, and hardening of
each service.

Run from anywhere: python3 docker/check.py. It needs PyYAML, and HAProxy for the balancer. Prints the errors and
exits with 1, or prints that it found none.
"""

import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

import yaml

ROOT = pathlib.Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docker"

# Keys of the compose specification that the file may use, so that a misspelled key is found.
TOP = {"name", "services", "volumes", "x-hardened"}
SERVICE = {
    "restart", "read_only", "cap_drop", "security_opt", "tmpfs", "pids_limit", "logging", "image", "build", "user",
    "command", "entrypoint", "ulimits", "environment", "ports", "volumes", "stop_grace_period", "healthcheck", "depends_on", "deploy", "profiles",
}
NESTED = {
    "build": {"context", "dockerfile"},
    "healthcheck": {"test", "interval", "timeout", "retries", "start_period"},
    "deploy": {"replicas", "resources"},
    "logging": {"driver", "options"},
}
DURATION = re.compile(r"\d+(ms|s|m|h)")


def faults_of_service(name, service, model):
    def wrong(text):
        return f"{name}: {text}"

    for key in service.keys() - SERVICE:
        yield wrong(f"unknown key {key}")
    for key, known in NESTED.items():
        for inner in service.get(key, {}).keys() - known:
            yield wrong(f"unknown key {key}.{inner}")
    if service.get("read_only") is not True:
        yield wrong("its root is writable")
    if service.get("cap_drop") != ["ALL"] or "no-new-privileges:true" not in service.get("security_opt", []):
        yield wrong("it keeps privileges that it does not need")
    if service.get("user", "0").split(":")[0] in ("0", "root"):
        yield wrong("it runs as root")
    check = service.get("healthcheck", {})
    if not runs_once(service) and (not check.get("test") or check["test"][0] != "CMD"):
        yield wrong("it has no health check without a shell")
    for key in ("interval", "timeout", "start_period"):
        if key in check and not DURATION.fullmatch(check[key]):
            yield wrong(f"healthcheck.{key} is not a duration")
    for port in service.get("ports", []):
        if not re.fullmatch(r"127\.0\.0\.1:\d+:\d+", port):
            yield wrong(f"port {port} is open to other machines")
    for volume in service.get("volumes", []):
        source, target = volume.split(":")[:2]
        if not target.startswith("/"):
            yield wrong(f"volume {volume} has no absolute path in the container")
        if source.startswith("."):
            if not (FOLDER / source).exists():
                yield wrong(f"{source} does not exist")
        elif source not in model["volumes"]:
            yield wrong(f"volume {source} is not declared")
    for other, how in service.get("depends_on", {}).items():
        awaited = model["services"].get(other, {})
        if how == {"condition": "service_completed_successfully"} and runs_once(awaited):
            continue
        if "healthcheck" not in awaited or how != {"condition": "service_healthy"}:
            yield wrong(f"it waits for {other}, which has no health check")
    build = service.get("build")
    if build and not (FOLDER / build["context"] / build["dockerfile"]).is_file():
        yield wrong(f"{build['dockerfile']} does not exist")
    if not build and ":" not in service["image"] and not built(service["image"], model):
        yield wrong(f"image {service['image']} has no version")
    for variable, value in service.get("environment", {}).items():
        if not isinstance(value, str):
            yield wrong(f"{variable} is not a string")
        if variable.startswith("SDFARM_") and variable not in variables():
            yield wrong(f"the program has no variable {variable}")


def runs_once(service):
    return service.get("restart") == "no"


def faults_of_head(text):
    """Checks the commands at the head: each must run before the variables of later ones are known."""
    if re.search(r"\$\{\w+:?\?", text):
        yield "a required variable, which stops every command that comes before its value is known"
    keys = re.findall(r"^# +docker compose .* run --rm server (key new .*)$", text, re.M)
    if not keys or not keys[0].endswith("--scope admin"):
        yield "the first key created by the commands at its head is not an administrator's"


def built(image, model):
    return any(other["image"] == image and "build" in other for other in model["services"].values())


def variables():
    sources = (ROOT / "cli" / "src").rglob("*.rs")
    return {name for source in sources for name in re.findall(r'"(SDFARM_[A-Z_]+)"', source.read_text())}


def faults_of_image(path):
    lines = [line.strip() for line in path.read_text().splitlines()]
    stages = [line for line in lines if line.startswith("FROM ")]
    for stage in stages:
        if not re.fullmatch(r"FROM \S+:[\w.-]*\d[\w.-]*( AS \w+)?", stage):
            yield f"{path.name}: {stage!r} has no version"
    last = lines[lines.index(stages[-1]):]
    if not any(re.fullmatch(r"USER \d+:\d+", line) and not line.startswith("USER 0") for line in last):
        yield f"{path.name}: it runs as root"
    if not any(line.startswith("HEALTHCHECK ") for line in last):
        yield f"{path.name}: it has no health check"
    for name in re.findall(r"\b(SDFARM_[A-Z_]+)=", "\n".join(last)):
        if name not in variables():
            yield f"{path.name}: the program has no variable {name}"


def faults_of_model(text):
    yield from faults_of_head(text)
    model = yaml.safe_load(text)
    for key in model.keys() - TOP:
        yield f"unknown key {key}"
    for name, service in model["services"].items():
        yield from faults_of_service(name, service, model)


def faults_of_cluster():
    """Checks that the services of the cluster name each other as they are."""
    services = yaml.safe_load((FOLDER / "compose.cluster.yml").read_text())["services"]
    path = FOLDER / "cluster" / "haproxy.cfg"
    replicas = services["server"].get("deploy", {}).get("replicas", 1)
    port = services["server"]["environment"]["SDFARM_LISTEN"].rsplit(":")[-1]
    for count, target in re.findall(r"server-template server (\d+) (\S+) ", path.read_text()) or [(0, "")]:
        if int(count) != replicas:
            yield f"haproxy.cfg: it sends requests to {count} servers"
        if target != f"server:{port}":
            yield f"haproxy.cfg: {target} is not where the servers listen"
    if replicas > 1 and "SDFARM_CLUSTER_SECRET" not in services["server"]["environment"]:
        yield "compose.cluster.yml: without a secret its servers exclude each other"
    yield from faults_of_secrets((FOLDER / "compose.cluster.yml").read_text())
    yield from faults_of_retries(path.read_text())
    bucket = re.match(r"s3://([^/]+)/", services["server"]["environment"]["SDFARM_STORE"]).group(1)
    if f"s3.bucket.create -name {bucket}" not in services["bucket"]["command"][0]:
        yield f"compose.cluster.yml: bucket {bucket} is not made"
    balancer = re.match(r"http://(\w+):(\d+)", services["worker"]["environment"]["SDFARM_SERVER"])
    if balancer.group(1) not in services["server"]["environment"]["SDFARM_HOST"].split(","):
        yield "compose.cluster.yml: the servers do not know the name that workers call them by"
    if f"bind :{balancer.group(2)}" not in path.read_text():
        yield "haproxy.cfg: it does not listen where workers connect"
    program = shutil.which("haproxy") or shutil.which("haproxy", path="/usr/sbin")
    if not program:
        print("skipped: haproxy is not installed, so its configuration is not parsed")
        return
    parsed = subprocess.run([program, "-c", "-f", path], capture_output=True, text=True, check=False)
    if parsed.returncode:
        yield f"haproxy.cfg: {parsed.stdout}{parsed.stderr}"


def faults_of_secrets(text):
    """Checks that the loop at the head of the file makes all secrets that it uses, and long enough ones."""
    names, size = re.search(r"^# +for name in (.*); do echo .*openssl rand -hex (\d+)", text, re.M).groups()
    made = {f"SDFARM_{name}" for name in names.split()}
    for name in set(re.findall(r"\$\{(SDFARM_[A-Z_]+(?:SECRET|PASSWORD))", text)) - made:
        yield f"compose.cluster.yml: the commands at its head do not make {name}"
    if 2 * int(size) < 32:
        yield "compose.cluster.yml: a secret of the servers has at least 32 characters"


def faults_of_retries(text):
    """Checks that the balancer sends only what may be done twice again after a server may have done it."""
    if re.search(r"^ +retry-on .*(empty-response|503|all-retryable-errors)", text, re.M) and not re.search(
        r"^ +http-request disable-l7-retry unless reads", text, re.M
    ):
        yield "haproxy.cfg: it sends any request again, also one that a server has done"


def faults():
    for path in sorted(FOLDER.glob("compose*.yml")):
        yield from (f"{path.name}: {fault}" for fault in faults_of_model(path.read_text()))
    yield from faults_of_cluster()
    for path in sorted(FOLDER.glob("Dockerfile*")):
        yield from faults_of_image(path)
    ignored = (ROOT / ".dockerignore").read_text().split()
    members = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["members"]
    sources = [path.read_text() for path in (ROOT / "server/src").rglob("*.rs")]
    embedded = {name for text in sources for name in re.findall(r'#\[folder = "\.\./(\w+)"\]', text)}
    for folder in [*sorted({member.split("/")[0] for member in members}), "migrations", "Cargo.lock", *sorted(embedded)]:
        if f"!{folder}" not in ignored:
            yield f".dockerignore: {folder} is not included in the build"


if __name__ == "__main__":
    found = list(faults())
    print("\n".join(found) if found else "the compose files and the images are valid")
    sys.exit(1 if found else 0)
