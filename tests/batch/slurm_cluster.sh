#!/usr/bin/env bash
# A SLURM of one node, this one, with everything that it writes in one folder: `slurm_cluster.sh start FOLDER`, then
# `export SLURM_CONF=FOLDER/slurm.conf`, and `slurm_cluster.sh stop FOLDER`. Needs Debian's slurm-wlm and munge, which
# `slurm_cluster.sh install` gets (as root); start and stop need no rights.
set -euo pipefail
export PATH=$PATH:/usr/sbin

install() {
    command -v slurmctld slurmd munged >/dev/null && return
    apt-get update
    DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends slurm-wlm munge
}

free_port() {
    python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])'
}

start() {
    local folder host user
    mkdir -p "$1"
    chmod 700 "$1"
    folder=$(cd "$1" && pwd)
    host=$(hostname -s)
    user=$(id -un)
    mkdir -p "$folder"/{munge,state,spool}
    head -c 128 /dev/urandom >"$folder/munge/key"
    chmod 600 "$folder/munge/key"
    chmod 711 "$folder"
    munged --force --key-file="$folder/munge/key" --socket="$folder/munge.socket" --pid-file="$folder/munged.pid" \
        --log-file="$folder/munge/log" --seed-file="$folder/munge/seed"
    cat >"$folder/slurm.conf" <<END
ClusterName=test
SlurmctldHost=$host(127.0.0.1)
SlurmUser=$user
SlurmdUser=$user
SlurmctldPort=$(free_port)
SlurmdPort=$(free_port)
AuthType=auth/munge
AuthInfo=socket=$folder/munge.socket
CredType=cred/munge
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_Core_Memory
SchedulerParameters=sched_interval=2
KillWait=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$(nproc) RealMemory=$(awk '/MemTotal/ {print int($2 / 1100)}' /proc/meminfo)
PartitionName=main Nodes=$host Default=YES MaxTime=INFINITE State=UP
END
    export SLURM_CONF="$folder/slurm.conf"
    slurmctld
    slurmd
    for _ in $(seq 100); do
        sinfo --noheader --format=%t 2>/dev/null | grep -q '^idle' && return
        sleep 0.2
    done
    tail "$folder"/*.log >&2
    exit 1
}

stop() {
    for daemon in slurmd slurmctld munged; do
        if [ -s "$1/$daemon.pid" ]; then kill "$(cat "$1/$daemon.pid")" || true; fi
    done
}

"$@"
