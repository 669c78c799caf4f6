/* Ranks over MPI (ranks.h). MPI is started only under a launcher: what launchers set in the environment tells. Errors of MPI end the run (MPI's default handler). */
#include "trainer/ranks.h"
#include <mpi.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

enum { MOST_BYTES = 1 << 30 };      /* of a message: MPI counts in int */
static int count = 1, here = 1, mine, started;

void ranks_start(void)
{
    static const char *const SIGNS[] = { "PMI_RANK", "PMI_FD", "PMIX_RANK", "OMPI_COMM_WORLD_SIZE" };
    for (size_t i = 0; i < sizeof SIGNS / sizeof *SIGNS; i++) started |= getenv(SIGNS[i]) != NULL;
    if (!started) return;
    int given;
    MPI_Init_thread(NULL, NULL, MPI_THREAD_FUNNELED, &given);
    MPI_Comm_size(MPI_COMM_WORLD, &count);
    MPI_Comm_rank(MPI_COMM_WORLD, &mine);
    MPI_Comm machine;
    MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, 0, MPI_INFO_NULL, &machine);
    MPI_Comm_size(machine, &here);
    MPI_Comm_free(&machine);
    if (count <= RANKS_MOST) return;
    if (!mine) fprintf(stderr, "oriel-train: %d ranks, at most %d can share a run\n", count, RANKS_MOST);
    ranks_fail();
}

void ranks_end(void)
{
    if (started) MPI_Finalize();
}

void ranks_fail(void)
{
    if (count < 2) return;
    usleep(500000);                 /* the launcher passes on what was said, if it has the time */
    MPI_Abort(MPI_COMM_WORLD, 1);
}

int ranks_count(void) { return count; }
int ranks_here(void) { return here; }
int ranks_mine(void) { return mine; }

void ranks_merge(void *bytes, size_t n)
{
    for (char *p = bytes; count > 1 && n;) {
        int now = n < MOST_BYTES ? (int)n : MOST_BYTES;
        MPI_Allreduce(MPI_IN_PLACE, p, now, MPI_BYTE, MPI_BOR, MPI_COMM_WORLD);
        p += now;
        n -= (size_t)now;
    }
}

void ranks_share(int from, void *bytes, size_t n)
{
    for (char *p = bytes; count > 1 && n;) {
        int now = n < MOST_BYTES ? (int)n : MOST_BYTES;
        MPI_Bcast(p, now, MPI_BYTE, from, MPI_COMM_WORLD);
        p += now;
        n -= (size_t)now;
    }
}

void ranks_send(int to, const void *bytes, size_t n)
{
    for (const char *p = bytes; n;) {
        int now = n < MOST_BYTES ? (int)n : MOST_BYTES;
        MPI_Send(p, now, MPI_BYTE, to, 0, MPI_COMM_WORLD);
        p += now;
        n -= (size_t)now;
    }
}

void ranks_receive(int from, void *bytes, size_t n)
{
    for (char *p = bytes; n;) {
        int now = n < MOST_BYTES ? (int)n : MOST_BYTES;
        MPI_Recv(p, now, MPI_BYTE, from, 0, MPI_COMM_WORLD, MPI_STATUS_IGNORE);
        p += now;
        n -= (size_t)now;
    }
}
