{{/* Start of the names of all objects. */}}
{{- define "sdfarm.name" -}}
{{- if contains .Chart.Name .Release.Name }}{{ .Release.Name | trunc 50 | trimSuffix "-" }}
{{- else }}{{ printf "%s-%s" .Release.Name .Chart.Name | trunc 50 | trimSuffix "-" }}{{ end }}
{{- end }}

{{/* Labels that select pods. Arguments: the root, and the component. */}}
{{- define "sdfarm.selector" -}}
app.kubernetes.io/name: {{ .root.Chart.Name }}
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .component }}
{{- end }}

{{/* Labels of all objects. */}}
{{- define "sdfarm.labels" -}}
{{ include "sdfarm.selector" . }}
app.kubernetes.io/version: {{ .root.Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .root.Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .root.Chart.Name .root.Chart.Version }}
{{- end }}

{{/* Name of an image. Arguments: the root, and the pool's own settings. */}}
{{- define "sdfarm.image" -}}
{{- $image := mergeOverwrite (dict) .root.Values.image (.image | default (dict)) -}}
{{ $image.repository }}:{{ $image.tag | default .root.Chart.AppVersion }}
{{- end }}

{{/* Address of the servers within the cluster. */}}
{{- define "sdfarm.address" -}}
http://{{ include "sdfarm.name" . }}.{{ .Release.Namespace }}.svc:{{ .Values.service.port }}
{{- end }}

{{/* Names under which clients may reach the servers. */}}
{{- define "sdfarm.hosts" -}}
{{- $name := include "sdfarm.name" . -}}
{{- $space := .Release.Namespace -}}
{{- $hosts := list $name (printf "%s.%s" $name $space) (printf "%s.%s.svc" $name $space) (printf "%s.%s.svc.cluster.local" $name $space) -}}
{{- if .Values.ingress.host }}{{ $hosts = append $hosts .Values.ingress.host }}{{ end -}}
{{- concat $hosts .Values.server.hosts | uniq | join "," -}}
{{- end }}

{{- define "sdfarm.podSecurity" -}}
runAsNonRoot: true
runAsUser: 10001
runAsGroup: 10001
fsGroup: 10001
fsGroupChangePolicy: OnRootMismatch
seccompProfile: { type: RuntimeDefault }
{{- end }}

{{- define "sdfarm.containerSecurity" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: { drop: [ALL] }
{{- end }}

{{/* Where pods run. Argument: the settings of the server or of a pool. */}}
{{- define "sdfarm.placement" -}}
{{- with .nodeSelector }}
nodeSelector: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .tolerations }}
tolerations: {{- toYaml . | nindent 2 }}
{{- end }}
{{- with .affinity }}
affinity: {{- toYaml . | nindent 2 }}
{{- end }}
{{- end }}

{{/* Whether a pool is scaled, as text. */}}
{{- define "sdfarm.isAnyScaled" -}}
{{- range .Values.workers }}{{ if and .enabled .scaling.enabled }}yes{{ end }}{{ end }}
{{- end }}

{{/* Combinations of values that cannot work. */}}
{{- define "sdfarm.check" -}}
{{- if and (gt (int .Values.server.replicas) 1) (not (and .Values.database.secret .Values.cluster.secret)) }}
{{- fail "server.replicas is more than 1: servers share PostgreSQL and a secret, so name their Secrets in database.secret and cluster.secret" }}
{{- end }}
{{- if and .Values.cluster.secret (not .Values.database.secret) }}
{{- fail "cluster.secret is set: servers share PostgreSQL, so name the Secret with its address in database.secret" }}
{{- end }}
{{- if and .Values.database.secret (not .Values.store.url) }}
{{- fail "database.secret is set: servers have no volume then, so set store.url to s3://BUCKET/PREFIX" }}
{{- end }}
{{- if not (or .Values.server.insecure .Values.keys.workers.secret) }}
{{- fail "keys.workers.secret is empty: name the Secret with the workers' key" }}
{{- end }}
{{- if and (include "sdfarm.isAnyScaled" .) (not .Values.server.insecure) (not .Values.keys.reader.secret) }}
{{- fail "a pool is scaled: name the Secret with a key of scope read in keys.reader.secret" }}
{{- end }}
{{- if and .Values.monitoring.serviceMonitor.enabled (not .Values.server.insecure) (not .Values.keys.reader.secret) }}
{{- fail "the farm is monitored: name the Secret with a key of scope read in keys.reader.secret" }}
{{- end }}
{{- end }}
