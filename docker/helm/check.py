"""Checks the chart without a cluster: it is rendered with each file in values/, and every object is checked.

Run from anywhere: python3 docker/helm/check.py HELM SDFARM, with the paths of both programs. It needs PyYAML,
kubernetes-validate, cloudcoil-models-keda and cloudcoil-models-prometheus-operator. Prints the errors and exits with 1, or
prints how many objects it checked.
"""

import importlib
import pathlib
import re
import subprocess
import sys
import tempfile

import jsonschema
import kubernetes_validate
import yaml

FOLDER = pathlib.Path(__file__).resolve().parent
ROOT = FOLDER.parent.parent
CHART = FOLDER / "sdfarm"
# The first version that the chart supports, and the newest that is known.
VERSIONS = ("1.27.0", kubernetes_validate.latest_version())
# Modules with the types of custom resources.
CUSTOM = {
    "keda.sh/v1alpha1": "cloudcoil.models.keda.v1alpha1",
    "monitoring.coreos.com/v1": "cloudcoil.models.prometheus_operator.v1",
}
# Values that the chart must reject, with a word of the message.
REJECTED = {
    "server: { replicas: 2 }": "database.secret and cluster.secret",
    "{ server: { replicas: 2 }, database: { secret: a }, store: { url: s3://b/c } }": "cluster.secret",
    "{ server: { replicas: 2 }, cluster: { secret: a }, store: { url: s3://b/c } }": "database.secret",
    "server: { replicas: 0 }": "replicas",
    "{ cluster: { secret: a }, store: { url: s3://b/c } }": "database.secret",
    "{ cluster: { secret: a }, database: { secret: b } }": "store.url",
    "cluster: { secrets: a }": "secrets",
    "database: { secret: a }": "store.url",
    "keys: { workers: { secret: '' } }": "keys.workers.secret",
    "workers: { cpu: { scaling: { enabled: true } } }": "keys.reader.secret",
    "monitoring: { serviceMonitor: { enabled: true } }": "keys.reader.secret",
    "ingress: { enabled: true }": "ingress.host",
    "workers: { cpu: { device: tpu } }": "device",
    "workers: { CPU: { enabled: false } }": "CPU",
    "server: { replica: 2 }": "replica",
    "store: { url: /data }": "url",
    "scaling: { targetSeconds: 0 }": "targetSeconds",
}


def helm(program, command, values, *arguments):
    """Runs helm on the chart; returns its exit status, its output and its errors."""
    call = [program, command, *arguments, "--values", str(values)]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def render(program, values):
    status, text, errors = helm(program, "template", values, "farm", str(CHART), "--namespace", "renders")
    return [document for document in yaml.safe_load_all(text) if document] if status == 0 else None, errors


def closed(schema):
    """The same schema without unknown keys, and without the null that stands for an absent key."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    schema = {key: closed(part) for key, part in schema.items()}
    if "properties" in schema:
        schema.setdefault("additionalProperties", False)
    return schema


def faults_of_schema(thing):
    if thing["apiVersion"] in CUSTOM:
        kind = getattr(importlib.import_module(CUSTOM[thing["apiVersion"]]), thing["kind"])
        errors = jsonschema.Draft202012Validator(closed(kind.model_json_schema())).iter_errors(thing)
        yield from (f"{error.json_path}: {error.message}" for error in errors)
        return
    for version in VERSIONS:
        try:
            kubernetes_validate.validate(thing, version, strict=True)
        except kubernetes_validate.ValidationError as error:
            yield f"{'.'.join(map(str, error.path))}: {error.message} (Kubernetes {version})"


def pod_of(thing):
    if thing["kind"] == "Pod":
        return thing["metadata"], thing["spec"]
    template = thing["spec"].get("template")
    return (template["metadata"], template["spec"]) if template else None


def faults_of_pod(thing, variables):
    metadata, pod = pod_of(thing)
    selector = thing["spec"].get("selector", {}).get("matchLabels", {})
    if not selector.items() <= metadata["labels"].items():
        yield "its selector does not select its pods"
    security = pod.get("securityContext", {})
    if not security.get("runAsNonRoot") or not security.get("runAsUser") or security.get("seccompProfile") != {"type": "RuntimeDefault"}:
        yield "it may run as root, or without a seccomp profile"
    if pod.get("automountServiceAccountToken") is not False:
        yield "it has a token of the cluster's API"
    if thing["kind"] != "Pod" and pod.get("terminationGracePeriodSeconds", 0) < 30:
        yield "it has no time to finish"
    volumes = {volume["name"] for volume in pod.get("volumes", [])}
    volumes |= {claim["metadata"]["name"] for claim in thing["spec"].get("volumeClaimTemplates", [])}
    for container in [*pod.get("initContainers", []), *pod["containers"]]:
        where = container["name"]
        expected = {"allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}}
        if container.get("securityContext") != expected:
            yield f"{where}: it keeps privileges that it does not need"
        if not re.fullmatch(r"\S+:\d[\w.-]*", container["image"]):
            yield f"{where}: image {container['image']} has no version"
        resources = container.get("resources", {})
        if "memory" not in resources.get("requests", {}):
            yield f"{where}: it requests no memory"
        for mount in container.get("volumeMounts", []):
            if mount["name"] not in volumes:
                yield f"{where}: volume {mount['name']} is not declared"
        names = [variable["name"] for variable in container.get("env", [])]
        if len(names) != len(set(names)):
            yield f"{where}: a variable occurs twice in {names}"
        script = " ".join(container["args"])
        commands = re.findall(r"\bsdfarm (\w+)", script) if "command" in container else [container["args"][0]]
        for name in names:
            if name.startswith("SDFARM_") and not any(name in variables(command) for command in commands):
                yield f"{where}: sdfarm {' and '.join(commands)} has no variable {name}"
        for key in ("startupProbe", "livenessProbe", "readinessProbe"):
            path = container.get(key, {}).get("httpGet", {}).get("path")
            if path and path not in routes():
                yield f"{where}: {key} requests {path}, which is no route"


def routes():
    return set(re.findall(r'GET +"([^"{]+)" ', (ROOT / "server/src/http.rs").read_text()))


def scaling_numbers():
    """Places of numbers that GET /v1/scaling returns."""
    source = (ROOT / "proto/src/scaling.rs").read_text()
    devices = re.findall(r"pub (\w+): DeviceScaling", source)
    return {f"{device}.{field}" for device in devices for field in re.findall(r"pub (\w+): u64", source)}


def faults_of_farm(things):
    """Checks what objects say about each other."""
    names = [(thing["kind"], thing["metadata"]["name"]) for thing in things]
    yield from (f"{name} occurs twice" for name in set(names) if names.count(name) > 1)
    pods = [(thing, *pod_of(thing)) for thing in things if "spec" in thing and pod_of(thing)]
    yield from faults_of_servers(names, pods)
    for thing in things:
        name = f"{thing['kind']} {thing['metadata']['name']}"
        spec = thing.get("spec", {})
        selector = None
        if thing["kind"] == "Service":
            selector = spec["selector"]
        elif thing["kind"] in ("PodDisruptionBudget", "NetworkPolicy"):
            selector = (spec.get("selector") or spec["podSelector"])["matchLabels"]
        if selector and not any(selector.items() <= metadata["labels"].items() for _, metadata, _ in pods):
            yield f"{name}: it selects no pods"
        if thing["kind"] == "ScaledObject":
            yield from (f"{name}: {fault}" for fault in faults_of_scaler(spec, names, things))
        if thing["kind"] == "ServiceMonitor":
            services = [other["metadata"]["labels"] for other in things if other["kind"] == "Service"]
            if not any(spec["selector"]["matchLabels"].items() <= labels.items() for labels in services):
                yield f"{name}: it selects no Service"
            yield from (f"{name}: {point['path']} is no route" for point in spec["endpoints"] if point["path"] not in routes())
        if thing["kind"] == "PrometheusRule" and spec != yaml.safe_load((ROOT / "docker/prometheus/alerts.yml").read_text()):
            yield f"{name}: its rules differ from docker/prometheus/alerts.yml"


def faults_of_servers(names, pods):
    """Checks that several servers run only where they may, and are replaced one by one."""
    servers = [thing for thing, metadata, _ in pods if metadata["labels"]["app.kubernetes.io/component"] == "server"]
    if len(servers) != 1:
        yield f"{len(servers)} objects have servers"
        return
    name, spec, pod = servers[0]["metadata"]["name"], servers[0]["spec"], pod_of(servers[0])[1]
    variables = {variable["name"]: variable for variable in pod["containers"][0]["env"]}
    shared, has_several = "SDFARM_CLUSTER_SECRET" in variables, spec["replicas"] > 1
    if has_several and not shared:
        yield f"{name}: its servers exclude each other without a secret"
    if shared and not {"SDFARM_DATABASE", "SDFARM_STORE"} <= variables.keys():
        yield f"{name}: servers that share a secret need a database and a store"
    rolling = {"type": "RollingUpdate", "rollingUpdate": {"maxSurge": 1, "maxUnavailable": 0}}
    if servers[0]["kind"] == "Deployment" and spec["strategy"] != (rolling if shared else {"type": "Recreate"}):
        yield f"{name}: a new server does not start {'before' if shared else 'after'} the old one stops"
    if has_several != (("PodDisruptionBudget", name) in names) or has_several != ("topologySpreadConstraints" in pod):
        yield f"{name}: a budget and a spread are for several servers"
    selector = spec["selector"]["matchLabels"]
    for constraint in pod.get("topologySpreadConstraints", []):
        if constraint["labelSelector"]["matchLabels"] != selector:
            yield f"{name}: other pods are counted by {constraint['topologyKey']}"


def faults_of_scaler(spec, names, things):
    target = spec["scaleTargetRef"]["name"]
    scaled = [thing for thing in things if thing["kind"] == "Deployment" and thing["metadata"]["name"] == target]
    if len(scaled) != 1 or "replicas" in scaled[0]["spec"]:
        yield f"{target} is no Deployment, or has a fixed number of replicas"
    for trigger in spec["triggers"]:
        metadata = trigger["metadata"]
        if metadata["valueLocation"] not in scaling_numbers():
            yield f"GET /v1/scaling has no number {metadata['valueLocation']}"
        if re.sub(r"^http://[^/]+|\?.*", "", metadata["url"]) not in routes():
            yield f"{metadata['url']} is no route"
        authentication = trigger.get("authenticationRef", {}).get("name")
        if (metadata.get("authMode") == "bearer") != (("TriggerAuthentication", authentication) in names):
            yield "it has no key, or one that it does not send"


def variables_of(program):
    """Variables of a command, as its help lists them."""
    known = {}

    def variables(command):
        if command not in known:
            texts = [[command, "--help"]] if command != "key" else [["key", "new", "--help"]]
            outputs = [subprocess.run([program, *words], capture_output=True, text=True, check=True).stdout for words in texts]
            known[command] = set(re.findall(r"\[env: (SDFARM_\w+)", "".join(outputs)))
        return known[command]

    return variables


def faults(program, variables):
    version = re.search(r'^version = "(.*)"', (ROOT / "Cargo.toml").read_text(), re.M).group(1)
    chart = yaml.safe_load((CHART / "Chart.yaml").read_text())
    if {chart["version"], chart["appVersion"]} != {version}:
        yield f"Chart.yaml: its version is not {version}"
    for path in sorted((FOLDER / "values").glob("*.yaml")):
        status, text, errors = helm(program, "lint", path, "--strict", str(CHART))
        if status:
            yield f"{path.name}: {text}{errors}"
        things, errors = render(program, path)
        if not things:
            yield f"{path.name}: {errors}"
            continue
        COUNTS.append(len(things))
        for thing in things:
            found = list(faults_of_schema(thing))
            found += faults_of_pod(thing, variables) if "spec" in thing and pod_of(thing) else []
            yield from (f"{path.name}: {thing['kind']} {thing['metadata']['name']}: {fault}" for fault in found)
        yield from (f"{path.name}: {fault}" for fault in faults_of_farm(things))
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        for values, word in REJECTED.items():
            file.seek(0)
            file.truncate()
            file.write(values)
            file.flush()
            things, errors = render(program, pathlib.Path(file.name))
            if things is not None or word not in errors:
                yield f"{values} is not rejected because of {word}: {errors}"


COUNTS = []

if __name__ == "__main__":
    found = list(faults(sys.argv[1], variables_of(sys.argv[2])))
    print("\n".join(found) if found else f"the chart is valid: {sum(COUNTS)} objects of {len(COUNTS)} files of values")
    sys.exit(1 if found else 0)
