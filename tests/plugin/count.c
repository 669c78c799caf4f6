/* A plugin of qemu's user-mode emulator for aarch64 (API 1, as in Debian 12's 7.2): executed instructions by function and mnemonic, for functions whose names begin as asked. tests/count.sh builds and runs it.
 *   -plugin count.so,out=FILE,name=PREFIX[,by=address]
 * FILE: one line a function and mnemonic, `FUNCTION MNEMONIC COUNT`; `FUNCTION calls COUNT` among them. by=address: the instruction's address, hexadecimal, in place of its mnemonic. Only what emulates one thread is counted right: the counters take no locks.
 * Debian ships no qemu-plugin.h; what is used of it is declared here. */
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef uint64_t plugin_id;
int qemu_plugin_version = 1;
int qemu_plugin_install(plugin_id id, const void *info, int argc, char **argv);
void qemu_plugin_register_vcpu_tb_trans_cb(plugin_id id, void (*cb)(plugin_id, struct qemu_plugin_tb *));
void qemu_plugin_register_atexit_cb(plugin_id id, void (*cb)(plugin_id, void *), void *user);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *tb);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *tb, size_t i);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *insn);
const char *qemu_plugin_insn_symbol(const struct qemu_plugin_insn *insn);
const void *qemu_plugin_insn_data(const struct qemu_plugin_insn *insn);
char *qemu_plugin_insn_disas(const struct qemu_plugin_insn *insn);
void qemu_plugin_register_vcpu_insn_exec_inline(struct qemu_plugin_insn *insn, int op, void *counter, uint64_t add);      /* op 0: add to a uint64_t */

enum { ROWS = 1 << 14, NAME = 64 };
static struct { char function[NAME], mnemonic[NAME]; uint64_t entry, count; } row[ROWS];
static int rows, by_address;
static const char *out, *prefix;

static int find(const char *function, const char *mnemonic, uint64_t entry)
{
    int i = 0;
    while (i < rows && (strcmp(row[i].function, function) || strcmp(row[i].mnemonic, mnemonic))) i++;
    if (i == ROWS) { fprintf(stderr, "count: more than %d rows\n", ROWS); exit(1); }
    if (i < rows) return i;
    snprintf(row[i].function, NAME, "%s", function);
    snprintf(row[i].mnemonic, NAME, "%s", mnemonic);
    row[i].entry = entry;
    return rows++;
}

/* The mnemonic, to be freed. Dot products are younger than the disassembler of Debian 12. */
static char *mnemonic(const struct qemu_plugin_insn *insn)
{
    char *text = qemu_plugin_insn_disas(insn);
    uint32_t code;
    memcpy(&code, qemu_plugin_insn_data(insn), 4);
    if ((code & 0xbf20fc00) == 0x0e009400 || (code & 0xbf00f400) == 0x0f00e000) strcpy(text, "sdot");
    text[strcspn(text, " \t")] = 0;
    return text;
}

static void translated(plugin_id id, struct qemu_plugin_tb *tb)
{
    (void)id;
    for (size_t i = 0; i < qemu_plugin_tb_n_insns(tb); i++) {
        struct qemu_plugin_insn *insn = qemu_plugin_tb_get_insn(tb, i);
        const char *symbol = qemu_plugin_insn_symbol(insn);
        if (!symbol || strncmp(symbol, prefix, strlen(prefix))) continue;
        uint64_t at = qemu_plugin_insn_vaddr(insn);
        int calls = find(symbol, "calls", at);      /* the first that is seen of a function is its entry */
        if (row[calls].entry == at) qemu_plugin_register_vcpu_insn_exec_inline(insn, 0, &row[calls].count, 1);
        char address[20], *text = NULL;
        snprintf(address, sizeof address, "%" PRIx64, at);
        if (!by_address) text = mnemonic(insn);
        qemu_plugin_register_vcpu_insn_exec_inline(insn, 0, &row[find(symbol, text ? text : address, 0)].count, 1);
        free(text);
    }
}

static void finished(plugin_id id, void *user)
{
    (void)id;
    (void)user;
    FILE *f = fopen(out, "w");
    if (!f) { perror(out); return; }
    for (int i = 0; i < rows; i++) fprintf(f, "%s %s %" PRIu64 "\n", row[i].function, row[i].mnemonic, row[i].count);
    fclose(f);
}

int qemu_plugin_install(plugin_id id, const void *info, int argc, char **argv)
{
    (void)info;
    for (int i = 0; i < argc; i++) {
        if (!strncmp(argv[i], "out=", 4)) out = strdup(argv[i] + 4);
        if (!strncmp(argv[i], "name=", 5)) prefix = strdup(argv[i] + 5);
        if (!strcmp(argv[i], "by=address")) by_address = 1;
    }
    if (!out || !prefix) { fprintf(stderr, "count: out= and name= are wanted\n"); return 1; }
    qemu_plugin_register_vcpu_tb_trans_cb(id, translated);
    qemu_plugin_register_atexit_cb(id, finished, NULL);
    return 0;
}
